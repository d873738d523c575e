"""What folding writes, each as one statement over a set, rows in the order of their keys."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime

from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.aggregation.evidence import Summary
from slamcu_server.aggregation.folding import CandidateFold
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.aggregation.resolve import ResolvedMessage

_PASS_TYPES = {
    "message": "bigint",
    "index_in_message": "integer",
    "map_id": "bigint",
    "contributor_id": "bigint",
    "started_at": "timestamptz",
    "ended_at": "timestamptz",
    "status": "text",
    "feature_class": "text",
    "sign": "text",
    "value": "text",
    "weight_for": "float8",
    "weight_against": "float8",
    "frames_detected": "integer",
    "frames_missed": "integer",
    "frames_blocked": "integer",
    "feature_id": "bigint",
    "watch_id": "bigint",
    "candidate_id": "bigint",
    "cov_xx": "float8",
    "cov_xy": "float8",
    "cov_yy": "float8",
    "map_sequence": "integer",
    "sensor_model": "text",
    "software_version": "text",
    "fleet_id": "text",
    "valid": "boolean",
    "trusted": "boolean",
    "archived": "boolean",
}
_BELIEF_TYPES = {
    "weight_for": "float8",
    "weight_against": "float8",
    "standing": "boolean",
    "contributors_for": "integer",
    "contributors_against": "integer",
    "passes": "integer",
    "last_looked": "timestamptz",
    "last_seen": "timestamptz",
    "last_informative": "timestamptz",
    "fades_at": "timestamptz",
    "policy_version": "text",
}
_FEATURE_TYPES = {
    "feature_id": "bigint",
    **_BELIEF_TYPES,
    "looked": "bigint",
    "blocked": "bigint",
    "passes_window": "bytea",
}
_FORGOTTEN_TYPES = {"forgotten_looked": "bigint", "forgotten_blocked": "bigint"}
_CANDIDATE_TYPES = {
    **_BELIEF_TYPES,
    "first_seen": "timestamptz",
    "founding_pass": "bigint",
    "map_id": "bigint",
    "feature_class": "text",
    "sign": "text",
    "value": "text",
    "cov_xx": "float8",
    "cov_xy": "float8",
    "cov_yy": "float8",
}

Row = dict[str, object]

_POINT = struct.Struct("<BIIdd").pack  # EWKB, little endian
_WGS84 = 0x20000001, 4326  # a point with a reference system, and which
_KNOWS_GEOMETRY = "slamcu_knows_geometry"


def belief_row(summary: Summary, policy_version: str) -> Row:
    """Return what the tables of features and candidates share about a summary."""
    return {
        "weight_for": summary.state.weight_for,
        "weight_against": summary.state.weight_against,
        "standing": summary.state.standing,
        "contributors_for": summary.state.contributors_for,
        "contributors_against": summary.state.contributors_against,
        "passes": summary.passes,
        "last_looked": summary.last_looked,
        "last_seen": summary.last_seen,
        "last_informative": summary.last_informative,
        "fades_at": summary.fades_at,
        "policy_version": policy_version,
    }


def feature_row(summary: Summary, policy_version: str) -> Row:
    """Return the row of a map feature, all but its id and what has been forgotten."""
    return {**belief_row(summary, policy_version), "looked": summary.looked, "blocked": summary.blocked}


def candidate_row(fold: CandidateFold, policy_version: str) -> Row:
    """Return a candidate's row, all but its id."""
    founder = fold.membership.founder
    xx, xy, yy = fold.place.covariance_m2
    return {
        **belief_row(fold.summary, policy_version),
        "first_seen": fold.summary.first_seen,
        "founding_pass": founder.id,
        "map_id": founder.map_id,
        "feature_class": founder.feature_class,
        "sign": fold.sign,
        "value": fold.value,
        "lon": fold.place.lon,
        "lat": fold.place.lat,
        "cov_xx": xx,
        "cov_xy": xy,
        "cov_yy": yy,
    }


async def insert_passes(connection: AsyncConnection, messages: Sequence[ResolvedMessage]) -> list[StoredPass]:
    """Store the passes of messages and return them with their ids."""
    types = {**_PASS_TYPES, "lon": "float8", "lat": "float8"}
    rows = [(*_pass_row(message, item), item.lon, item.lat) for message in messages for item in message.passes]
    columns = ", ".join(_PASS_TYPES)
    result = await connection.execute(
        text(f"""
        INSERT INTO passes ({columns}, geom)
        SELECT {columns}, ST_SetSRID(ST_MakePoint(lon, lat), 4326) FROM {unnest(types)}
        RETURNING message, index_in_message, id"""),  # noqa: S608  (constants)
        {name: [row[number] for row in rows] for number, name in enumerate(types)},
    )
    ids = {(row.message, row.index_in_message): row.id for row in result}
    return [replace(item, id=ids[message.claimed.id, item.key[3]]) for message in messages for item in message.passes]


async def copy_passes(connection: AsyncConnection, messages: Iterable[ResolvedMessage]) -> None:
    """Store the passes of messages whose ids nobody asks for: three times as fast as `insert_passes`."""
    rows = [(*_pass_row(message, item), _point(item)) for message in messages for item in message.passes]
    driver = (await connection.get_raw_connection()).driver_connection
    if driver is None:
        raise ConnectionError("the connection to store passes on is closed")
    if not connection.info.get(_KNOWS_GEOMETRY):
        found = await connection.execute(
            text("SELECT nspname FROM pg_type JOIN pg_namespace n ON n.oid = typnamespace WHERE typname = 'geometry'")
        )
        schema = found.scalar_one()
        await driver.set_type_codec("geometry", schema=schema, encoder=bytes, decoder=bytes, format="binary")
        connection.info[_KNOWS_GEOMETRY] = True
    await driver.copy_records_to_table("passes", records=rows, columns=[*_PASS_TYPES, "geom"])


async def upsert_feature_states(connection: AsyncConnection, rows: Mapping[int, Row]) -> None:
    """Write what is believed about map features, given by their ids."""
    ordered = [{"feature_id": key, **rows[key]} for key in sorted(rows)]
    await upsert_feature_columns(connection, arrays({**_FEATURE_TYPES, **_FORGOTTEN_TYPES}, ordered))


async def upsert_feature_columns(connection: AsyncConnection, values: Mapping[str, Sequence[object]]) -> None:
    """Write what is believed about map features, given by columns in the order of their ids."""
    types = {**_FEATURE_TYPES, **_FORGOTTEN_TYPES}
    columns = ", ".join(types)
    updates = ", ".join(
        [f"{name} = EXCLUDED.{name}" for name in _FEATURE_TYPES if name != "feature_id"]
        + [f"{name} = feature_states.{name} + EXCLUDED.{name}" for name in _FORGOTTEN_TYPES]
    )
    await connection.execute(
        text(f"""
        INSERT INTO feature_states ({columns}, window_at) SELECT {columns}, now() FROM {unnest(types)}
        ON CONFLICT (feature_id) DO UPDATE SET {updates}, updated_at = now(), window_at = now()"""),  # noqa: S608  (constants)
        {name: values[name] for name in types},
    )


async def insert_candidates(connection: AsyncConnection, rows: Sequence[Row]) -> dict[int, int]:
    """Write new candidates and return their ids by founding pass."""
    columns = ", ".join(_CANDIDATE_TYPES)
    types = {**_CANDIDATE_TYPES, "lon": "float8", "lat": "float8"}
    result = await connection.execute(
        text(f"""
        INSERT INTO candidates ({columns}, geom)
        SELECT {columns}, ST_SetSRID(ST_MakePoint(lon, lat), 4326) FROM {unnest(types)}
        RETURNING founding_pass, id"""),  # noqa: S608  (constants)
        arrays(types, rows),
    )
    return {row.founding_pass: row.id for row in result}


async def update_candidates(connection: AsyncConnection, rows: Mapping[int, Row]) -> None:
    """Write what is believed about candidates that are there; each stands for itself again if it was merged."""
    types = {"id": "bigint", **_CANDIDATE_TYPES, "lon": "float8", "lat": "float8"}
    kept = [name for name in _CANDIDATE_TYPES if name not in ("founding_pass", "map_id")]
    updates = ", ".join(f"{name} = r.{name}" for name in kept)
    await connection.execute(
        text(f"""
        UPDATE candidates c SET {updates}, geom = ST_SetSRID(ST_MakePoint(r.lon, r.lat), 4326), merged_into = NULL
        FROM {unnest(types)} WHERE c.id = r.id"""),  # noqa: S608  (constants)
        arrays(types, [{"id": key, **rows[key]} for key in sorted(rows)]),
    )


async def merge_candidates(connection: AsyncConnection, into: Mapping[int, int]) -> None:
    """Say of candidates which other one their founding passes now belong to."""
    types = {"id": "bigint", "target": "bigint"}
    await connection.execute(
        text(f"UPDATE candidates c SET merged_into = r.target FROM {unnest(types)} WHERE c.id = r.id"),  # noqa: S608
        arrays(types, [{"id": key, "target": into[key]} for key in sorted(into)]),
    )


async def assign_passes(connection: AsyncConnection, candidates: Mapping[int, int | None]) -> None:
    """Say of passes which candidate they count for."""
    types = {"id": "bigint", "candidate_id": "bigint"}
    await connection.execute(
        text(f"UPDATE passes p SET candidate_id = r.candidate_id FROM {unnest(types)} WHERE p.id = r.id"),  # noqa: S608
        arrays(types, [{"id": key, "candidate_id": candidates[key]} for key in sorted(candidates)]),
    )


async def delete_passes(connection: AsyncConnection, ids: Iterable[int]) -> None:
    """Forget passes that no fold will need again: nothing about a vehicle is kept longer than it serves."""
    await connection.execute(text("DELETE FROM passes WHERE id = ANY(CAST(:ids AS bigint[]))"), {"ids": sorted(ids)})


async def delete_passes_before(connection: AsyncConnection, ends: Mapping[int, datetime]) -> None:
    """Forget the passes over map features that ended before a time of each, as `delete_passes` does by their ids."""
    types = {"id": "bigint", "end": "timestamptz"}
    await connection.execute(
        text(f"""
        DELETE FROM passes p USING {unnest(types)}
        WHERE p.feature_id = r.id AND p.ended_at < r."end"
          AND NOT p.archived AND p.retraction_id IS NULL"""),  # noqa: S608  (constants)
        arrays(types, [{"id": key, "end": ends[key]} for key in sorted(ends)]),
    )


def _point(item: StoredPass) -> bytes | None:
    return None if item.lon is None or item.lat is None else _POINT(1, *_WGS84, item.lon, item.lat)


def _pass_row(message: ResolvedMessage, item: StoredPass) -> tuple[object, ...]:
    """Return a pass in the order of _PASS_TYPES."""
    report = message.report
    frames = report.passes[item.key[3]]
    return (
        message.claimed.id,
        item.key[3],
        item.map_id,
        item.contributor,
        item.started_at,
        item.ended_at,
        item.status.value,
        item.feature_class,
        item.sign,
        item.value,
        item.weight_for,
        item.weight_against,
        frames.frames_detected,
        frames.frames_missed,
        frames.frames_blocked,
        item.feature_id,
        item.watch_id,
        item.candidate_id,
        *(item.covariance_m2 or (None, None, None)),
        message.map_sequence,
        report.sensor_model,
        report.software_version,
        report.fleet_id,
        item.valid,
        item.trusted,
        item.archived,
    )
