"""What folding writes, each as one statement over a set, rows in the order of their keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation.binary import Column, copy, text_field
from slamcu_server.aggregation.boxes import PROBE
from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.aggregation.evidence import Summary
from slamcu_server.aggregation.folding import CandidateFold
from slamcu_server.database.statements import text

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
_FORGOTTEN_TYPES = {"forgotten_looked": "bigint", "forgotten_blocked": "bigint"}
FEATURE_TYPES = {
    "feature_id": "bigint",
    **_BELIEF_TYPES,
    "looked": "bigint",
    "blocked": "bigint",
    "passes_window": "bytea",
    **_FORGOTTEN_TYPES,
}
"""The columns of `feature_states` that are written, and their types."""

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

_GIVEN = "given_feature_states"

Row = dict[str, object]


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


async def upsert_feature_states(connection: AsyncConnection, rows: Mapping[int, Row]) -> None:
    """Write what is believed about map features, given by their ids."""
    if not rows:
        return
    ordered = [{"feature_id": key, **rows[key]} for key in sorted(rows)]
    await connection.execute(text(_upsert(unnest(FEATURE_TYPES))), arrays(FEATURE_TYPES, ordered))


async def upsert_feature_columns(
    connection: AsyncConnection, columns: Mapping[str, Column], windows: Sequence[bytes], policy_version: str
) -> None:
    """Write what is believed about map features of which nothing fades, given by columns and their windows."""
    if not windows:
        return
    given = {name: kind for name, kind in FEATURE_TYPES.items() if name in columns}
    # The table is empty whenever a transaction begins, and ends with the connection.
    await connection.execute(
        text(f"""
        CREATE TEMPORARY TABLE IF NOT EXISTS {_GIVEN} ({", ".join(f"{name} {kind}" for name, kind in given.items())},
            passes_window bytea) WITH (toast_tuple_target = 8160) ON COMMIT DELETE ROWS""")
    )
    await copy(connection, _GIVEN, columns, ["passes_window"], [text_field(window) for window in windows])
    source = (
        f"(SELECT *, CAST(NULL AS timestamptz) AS fades_at, CAST(:policy AS text) AS policy_version FROM {_GIVEN}) r"  # noqa: S608  (a constant)
    )
    await connection.execute(text(_upsert(source)), {"policy": policy_version})


def _upsert(source: str) -> str:
    """Return the SQL that writes beliefs about map features out of a table with their columns."""
    columns = ", ".join(FEATURE_TYPES)
    updates = ", ".join(
        [f"{name} = EXCLUDED.{name}" for name in FEATURE_TYPES if name not in {"feature_id", *_FORGOTTEN_TYPES}]
        + [f"{name} = feature_states.{name} + EXCLUDED.{name}" for name in _FORGOTTEN_TYPES]
    )
    return f"""
        INSERT INTO feature_states ({columns}, window_at) SELECT {columns}, now() FROM {source}
        ON CONFLICT (feature_id) DO UPDATE SET {updates}, updated_at = now(), window_at = now()"""  # noqa: S608  (constants)


async def insert_candidates(connection: AsyncConnection, rows: Sequence[Row]) -> dict[int, int]:
    """Write new candidates and return their ids by founding pass."""
    if not rows:
        return {}
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
    if not rows:
        return
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
    if not into:
        return
    types = {"id": "bigint", "target": "bigint"}
    await connection.execute(
        text(f"UPDATE candidates c SET merged_into = r.target FROM {unnest(types)} WHERE c.id = r.id"),  # noqa: S608
        arrays(types, [{"id": key, "target": into[key]} for key in sorted(into)]),
    )


async def assign_passes(connection: AsyncConnection, candidates: Mapping[int, int | None]) -> None:
    """Say of passes which candidate they count for."""
    if not candidates:
        return
    types = {"id": "bigint", "candidate_id": "bigint"}
    await connection.execute(
        text(f"UPDATE passes p SET candidate_id = r.candidate_id FROM {unnest(types)} WHERE p.id = r.id"),  # noqa: S608
        arrays(types, [{"id": key, "candidate_id": candidates[key]} for key in sorted(candidates)]),
    )


async def delete_passes(connection: AsyncConnection, ids: Iterable[int]) -> None:
    """Forget passes that no fold will need again: nothing about a vehicle is kept longer than it serves."""
    if gone := sorted(ids):
        await connection.execute(text("DELETE FROM passes WHERE id = ANY(CAST(:ids AS bigint[]))"), {"ids": gone})


async def delete_passes_before(connection: AsyncConnection, ends: Mapping[int, datetime]) -> None:
    """Forget the passes over map features that ended before a time of each, as `delete_passes` does by their ids."""
    if not ends:
        return
    types = {"id": "bigint", "end": "timestamptz"}
    # an array, so that the passes are found by their index, however many are stored
    await connection.execute(
        text(f"""
        DELETE FROM passes WHERE id = ANY(ARRAY(
            SELECT p.id FROM {unnest(types)} CROSS JOIN LATERAL (
                SELECT id FROM passes WHERE feature_id = r.id AND ended_at < r."end"
                AND NOT archived AND retraction_id IS NULL {PROBE}) p))"""),  # noqa: S608  (constants)
        arrays(types, [{"id": key, "end": ends[key]} for key in sorted(ends)]),
    )
