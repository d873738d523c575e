"""What folding reads, each as one statement over a set; called after the locks are held."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.reports import DetectionStatus
from slamcu_server.aggregation.boxes import PROBE, both_sides, box, degrees
from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.aggregation.resolve import NearbyFeature
from slamcu_server.database.statements import text

_SELECT = """
SELECT p.id, p.contributor_id, m.session_id, m.message_id, p.index_in_message, p.map_id, p.started_at, p.ended_at,
       p.status, p.feature_class, p.sign, p.value, p.weight_for, p.weight_against, p.valid, p.trusted,
       p.feature_id, p.watch_id, p.candidate_id, ST_X(p.geom) AS lon, ST_Y(p.geom) AS lat, p.cov_xx, p.cov_xy, p.cov_yy
FROM passes p JOIN messages m ON m.id = p.message
"""
_STATUS = {status.value: status for status in DetectionStatus}
_COUNTS = "NOT p.archived AND p.retraction_id IS NULL"
_UNREFERENCED = f"p.feature_id IS NULL AND p.watch_id IS NULL AND {_COUNTS}"  # the partial index's predicate, and more


@dataclass(frozen=True, slots=True)
class MappedFeature:
    """A map feature as its newest version has it."""

    id: int
    map_id: int
    object_id: int
    in_map: bool  # whether the map's current version has it
    feature_class: str
    sign: str | None
    value: str | None
    existence_confidence: float
    position_std_m: float
    heading_deg: float | None
    lon: float
    lat: float


@dataclass(frozen=True, slots=True)
class KnownCandidate:
    """A candidate as stored."""

    id: int
    founding_pass: int
    merged_into: int | None


async def anchors(connection: AsyncConnection, ids: Iterable[int]) -> list[tuple[int, float, float]]:
    """Return (map id, lon, lat) of where map features were first mapped, and of where their maps have them now."""
    if not (asked := sorted(set(ids))):
        return []
    found = await connection.execute(
        text("""
        SELECT map_id, ST_X(geom) AS lon, ST_Y(geom) AS lat FROM feature_versions v
        WHERE feature_id = ANY(CAST(:ids AS bigint[])) AND (to_sequence IS NULL OR from_sequence = (
            SELECT min(from_sequence) FROM feature_versions first WHERE first.feature_id = v.feature_id))"""),
        {"ids": asked},
    )
    return [(row.map_id, row.lon, row.lat) for row in found]


async def reported_features(connection: AsyncConnection) -> set[int]:
    """Return the features about which anything is believed beyond what the map says."""
    query = f"""
        SELECT feature_id FROM feature_states
        UNION SELECT feature_id FROM passes p WHERE feature_id IS NOT NULL AND {_COUNTS}"""  # noqa: S608  (constants)
    return {row.feature_id for row in await connection.execute(text(query))}


async def features(connection: AsyncConnection, ids: Iterable[int]) -> dict[int, MappedFeature]:
    """Return map features by id, as their newest version has them."""
    found = await connection.execute(
        text("""
        SELECT DISTINCT ON (f.id) f.id, f.map_id, f.object_id, v.to_sequence IS NULL AS in_map, v.feature_class,
               v.sign, v.value, v.existence_confidence, v.position_std_m, v.heading_deg, ST_X(v.geom) AS lon,
               ST_Y(v.geom) AS lat
        FROM features f JOIN feature_versions v ON v.feature_id = f.id
        WHERE f.id = ANY(CAST(:ids AS bigint[])) ORDER BY f.id, v.from_sequence DESC"""),
        {"ids": sorted(set(ids))},
    )
    return {row.id: MappedFeature(**row._mapping) for row in found}  # noqa: SLF001  (a row's public mapping)


async def features_near(
    connection: AsyncConnection, places: Sequence[tuple[int, float, float]], reach_deg: float
) -> list[list[NearbyFeature]]:
    """Return for each place (map id, lon, lat) the features of the current map in a box around it."""
    types = {"place": "integer", "map_id": "bigint", "lon": "float8", "lat": "float8"}
    rows = [
        dict(zip(types, (index, *side), strict=True))
        for index, place in enumerate(places)
        for side in both_sides([place])
    ]
    if not rows:
        return []
    found = await connection.execute(
        text(f"""
        SELECT r.place, v.feature_id AS id, first.since, v.feature_class, v.sign, v.value, v.position_std_m,
               ST_X(v.geom) AS lon, ST_Y(v.geom) AS lat
        FROM {unnest(types)}
        CROSS JOIN LATERAL (
            SELECT * FROM feature_versions WHERE geom && {box("r")} AND map_id = r.map_id AND to_sequence IS NULL
            {PROBE}) v
        CROSS JOIN LATERAL (
            SELECT COALESCE(max(evidence_sequence), min(from_sequence)) AS since
            FROM feature_versions WHERE feature_id = v.feature_id) first
        ORDER BY r.place, v.feature_id"""),  # noqa: S608  (constants)
        {**arrays(types, rows), "reach": reach_deg},
    )
    near: list[list[NearbyFeature]] = [[] for _ in places]
    for row in found:
        near[row.place].append(
            NearbyFeature(
                row.id, row.since, row.feature_class, row.sign, row.value, row.position_std_m, row.lon, row.lat
            )
        )
    return near


async def passes_near(
    connection: AsyncConnection, places: Iterable[tuple[int, float, float]], reach_m: float
) -> list[StoredPass]:
    """Return every pass that clusters and that steps of at most `reach_m` connect to one of the places.

    A superset: steps are taken by boxes. What no pass connects is left out.
    """
    types = {"map_id": "bigint", "lon": "float8", "lat": "float8"}
    query = text(f"""{_SELECT} JOIN (
            SELECT DISTINCT near.id FROM {unnest(types)} CROSS JOIN LATERAL (
                SELECT id FROM passes WHERE geom && {box("r")} AND map_id = r.map_id
                AND feature_id IS NULL AND watch_id IS NULL AND NOT archived AND retraction_id IS NULL
                {PROBE}) near
        ) close ON close.id = p.id
        WHERE NOT p.id = ANY(CAST(:seen AS bigint[]))""")  # noqa: S608  (constants)
    found: dict[int, StoredPass] = {}
    reach_deg = degrees(reach_m)
    asked = set[tuple[int, float, float]]()
    frontier = sorted(set(places))
    while frontier:
        asked |= set(frontier)
        rows = [dict(zip(types, place, strict=True)) for place in both_sides(frontier)]
        result = await connection.execute(query, {**arrays(types, rows), "reach": reach_deg, "seen": sorted(found)})
        fresh = [item for item in map(stored_pass, result.all()) if item.clusters]
        found |= {item.id: item for item in fresh}
        frontier = sorted({(item.map_id, *item.place[:2]) for item in fresh if item.place} - asked)
    return list(found.values())


async def all_clustering_passes(connection: AsyncConnection) -> list[StoredPass]:
    """Return every pass that clusters."""
    result = await connection.execute(text(f"{_SELECT} WHERE {_UNREFERENCED}"))
    return [item for item in map(stored_pass, result.all()) if item.clusters]


async def passes_over_features(connection: AsyncConnection, ids: Iterable[int] | None) -> dict[int, list[StoredPass]]:
    """Return the passes that count for map features (all of them if none are named), by feature."""
    wanted = "p.feature_id IS NOT NULL" if ids is None else "p.feature_id = ANY(CAST(:ids AS bigint[]))"
    parameters = {} if ids is None else {"ids": sorted(set(ids))}
    result = await connection.execute(text(f"{_SELECT} WHERE {wanted} AND {_COUNTS}"), parameters)
    by_feature: dict[int, list[StoredPass]] = {}
    for item in map(stored_pass, result.all()):
        if item.feature_id is not None:
            by_feature.setdefault(item.feature_id, []).append(item)
    return by_feature


async def passes_over_feature_before(connection: AsyncConnection, feature_id: int, version: str) -> list[StoredPass]:
    """Return the passes that spoke about a feature as it was until a version of its map, archived by now or not."""
    result = await connection.execute(
        text(f"""{_SELECT} JOIN map_versions v ON v.map_id = p.map_id AND v.version = :version
        WHERE p.feature_id = :id AND p.retraction_id IS NULL AND p.map_sequence < v.sequence
          AND p.map_sequence >= COALESCE((
            SELECT max(evidence_sequence) FROM feature_versions
            WHERE feature_id = :id AND evidence_sequence < v.sequence), 0)"""),  # noqa: S608  (constants)
        {"id": feature_id, "version": version},
    )
    return [stored_pass(row) for row in result.all()]


async def passes_over_watches(connection: AsyncConnection, ids: Iterable[int]) -> dict[int, list[StoredPass]]:
    """Return the passes that named watch features and still count for candidates, by watch feature."""
    if not (asked := sorted(set(ids))):
        return {}
    result = await connection.execute(
        text(f"{_SELECT} WHERE p.watch_id = ANY(CAST(:ids AS bigint[])) AND p.feature_id IS NULL AND {_COUNTS}"),
        {"ids": asked},
    )
    by_watch: dict[int, list[StoredPass]] = {}
    for item in map(stored_pass, result.all()):
        if item.watch_id is not None:
            by_watch.setdefault(item.watch_id, []).append(item)
    return by_watch


async def passes_over_candidate(connection: AsyncConnection, candidate_id: int) -> list[StoredPass]:
    """Return the passes that count for a candidate, or did until it was accepted."""
    result = await connection.execute(
        text(f"{_SELECT} WHERE p.candidate_id = :id AND p.retraction_id IS NULL"), {"id": candidate_id}
    )
    return [stored_pass(row) for row in result.all()]


async def passes_over_candidates(connection: AsyncConnection, ids: Iterable[int]) -> dict[int, list[StoredPass]]:
    """Return the passes that count for candidates, by candidate."""
    result = await connection.execute(
        text(f"{_SELECT} WHERE p.candidate_id = ANY(CAST(:ids AS bigint[])) AND p.feature_id IS NULL AND {_COUNTS}"),
        {"ids": sorted(set(ids))},
    )
    by_candidate: dict[int, list[StoredPass]] = {}
    for item in map(stored_pass, result.all()):
        if item.candidate_id is not None:
            by_candidate.setdefault(item.candidate_id, []).append(item)
    return by_candidate


async def nameless_passes(connection: AsyncConnection, ids: Iterable[int]) -> list[tuple[StoredPass, int]]:
    """Return those of some passes that count and name nothing, each with the map version that its vehicle knew."""
    parameters = {"ids": sorted(set(ids))}
    found = await connection.execute(
        text(f"{_SELECT} WHERE p.id = ANY(CAST(:ids AS bigint[])) AND {_UNREFERENCED} ORDER BY p.id"), parameters
    )
    sequences = await connection.execute(
        text("SELECT id, map_sequence FROM passes WHERE id = ANY(CAST(:ids AS bigint[]))"), parameters
    )
    known = {row.id: row.map_sequence for row in sequences}
    return [(item, known[item.id]) for item in map(stored_pass, found.all())]


async def candidates_founded_by(connection: AsyncConnection, pass_ids: Iterable[int]) -> dict[int, KnownCandidate]:
    """Return the candidates bound to passes, by founding pass."""
    found = await connection.execute(
        text("SELECT id, founding_pass, merged_into FROM candidates WHERE founding_pass = ANY(CAST(:ids AS bigint[]))"),
        {"ids": sorted(set(pass_ids))},
    )
    return {row.founding_pass: KnownCandidate(row.id, row.founding_pass, row.merged_into) for row in found}


def stored_pass(row: Row[*tuple[Any, ...]]) -> StoredPass:
    """Read a pass from its row."""
    # by position, in the order of _SELECT: by name takes twice as long
    (
        key, contributor, session, message, index, map_id, started_at, ended_at, status, feature_class, sign, value,
        weight_for, weight_against, valid, trusted, feature_id, watch_id, candidate_id, lon, lat, xx, xy, yy,
    ) = row  # fmt: skip
    return StoredPass(
        key,
        (contributor, session, message, index),
        map_id,
        started_at,
        ended_at,
        _STATUS[status],
        feature_class,
        sign,
        value,
        weight_for,
        weight_against,
        valid,
        trusted,
        feature_id,
        watch_id,
        candidate_id,
        None if xx is None else (lon, lat, (xx, xy, yy)),
    )
