"""What the database knows about the maps, map features and watch features that messages name."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation.boxes import PROBE
from slamcu_server.aggregation.bulk import array, arrays, given, unnest
from slamcu_server.aggregation.condensed import NAMES, WATCHED, Reported
from slamcu_server.database.statements import text

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class KnownFeatures:
    """N map features, in order of map and object id."""

    map_id: NDArray[np.int64]
    object_id: NDArray[np.int64]
    id: NDArray[np.int64]
    lon: NDArray[np.float64]  # degrees, where it was first mapped: that never changes, so its cell is what to lock
    lat: NDArray[np.float64]
    since: NDArray[np.int64]  # the first map version in which it was this thing at this place
    feature_class: NDArray[np.str_]  # as its newest version has it
    existence_confidence: NDArray[np.float64]

    def find(self, map_id: NDArray[np.int64], object_id: NDArray[np.int64]) -> Indices:
        """Return the number of each of P features that are named by map and object id, -1 for one that is not known."""
        found = np.full(len(object_id), -1, np.intp)
        for one in np.unique(map_id).tolist():
            begin, end = np.searchsorted(self.map_id, [one, one + 1])
            if begin == end:
                continue
            asked = np.flatnonzero(map_id == one)
            at = np.minimum(begin + np.searchsorted(self.object_id[begin:end], object_id[asked]), end - 1)
            found[asked] = np.where(self.object_id[at] == object_id[asked], at, -1)
        return found


@dataclass(frozen=True, slots=True)
class WatchReference:
    """A watch feature: the candidate it is now part of, or the map feature it has become, and its founding place.

    Of one whose founding find counted for that map feature, and is not kept any more, where this was first mapped.
    """

    id: int
    map_id: int
    candidate_id: int
    feature_id: int | None
    lon: float
    lat: float
    dissolved: bool = False  # nothing stands behind it: its founding pass was taken out


@dataclass(frozen=True, slots=True)
class Lookups:
    """What the database knows about the things that messages name."""

    versions: Mapping[tuple[str, str], tuple[int, int]]  # (source, version) to (map id, sequence)
    features: KnownFeatures
    watches: Mapping[int, WatchReference]
    current: Mapping[int, int]  # current sequence by map id


async def lookups(connection: AsyncConnection, reported: Reported) -> Lookups:
    """Return what the database knows about the maps, features and watch features that messages name."""
    types = {"source": "text", "version": "text"}
    identities = sorted({(one.source, one.version) for one in reported.envelopes})
    rows = [dict(zip(types, identity, strict=True)) for identity in identities]
    found = await connection.execute(
        text(f"""
        SELECT m.source, v.version, v.map_id, v.sequence FROM {unnest(types)}
        JOIN maps m ON m.source = r.source JOIN map_versions v ON v.map_id = m.id AND v.version = r.version"""),  # noqa: S608  (constants)
        arrays(types, rows),
    )
    versions = {(row.source, row.version): (row.map_id, row.sequence) for row in found}
    maps = sorted({map_id for map_id, _ in versions.values()})
    current = await _current_sequences(connection, maps)  # before the features: what changes later is seen to
    watched = reported.has(WATCHED)
    objects = reported.records["object_id"]
    return Lookups(
        versions=versions,
        features=await _features(connection, maps, np.unique(objects[reported.has(NAMES) & ~watched])),
        watches=await watches(connection, objects[watched].tolist()),
        current=current,
    )


async def lookups_again(connection: AsyncConnection, known: Lookups) -> Lookups:
    """Return what is known as it is now: watch features, and map features if their maps have new versions.

    The very same if nothing has changed.
    """
    now = await watches(connection, known.watches)
    current = await _current_sequences(connection, sorted(known.current))
    if current != known.current:
        objects = np.unique(known.features.object_id)
        return replace(
            known, watches=now, current=current, features=await _features(connection, sorted(current), objects)
        )
    return known if now == known.watches else replace(known, watches=now)


async def _current_sequences(connection: AsyncConnection, maps: Sequence[int]) -> dict[int, int]:
    found = await connection.execute(
        text("SELECT id, current_sequence FROM maps WHERE id = ANY(CAST(:ids AS bigint[]))"), {"ids": maps}
    )
    return {row.id: row.current_sequence for row in found}


async def _features(
    connection: AsyncConnection, map_ids: Collection[int], object_ids: NDArray[np.int64]
) -> KnownFeatures:
    """Return the features of some maps with some object ids, one column after the other."""
    found = await connection.execute(
        text(f"""
        SELECT array_agg(f.map_id), array_agg(f.object_id), array_agg(f.id), array_agg(v.from_sequence),
            array_agg(v.evidence_sequence), array_agg(ST_X(v.geom)), array_agg(ST_Y(v.geom)),
            array_agg(v.feature_class), array_agg(v.existence_confidence)
        FROM unnest({array("objects", "bigint")}) AS r(object_id)
        CROSS JOIN LATERAL (
            SELECT map_id, object_id, id FROM features
            WHERE map_id = ANY(CAST(:maps AS bigint[])) AND object_id = r.object_id {PROBE}) f
        JOIN feature_versions v ON v.feature_id = f.id"""),  # noqa: S608  (constants)
        {"maps": map_ids, "objects": given("bigint", object_ids.tolist())},
    )
    columns = [column or () for column in found.one()]
    maps, objects, ids, begins, renewed = (
        np.array([0 if each is None else each for each in column], np.int64) for column in columns[:5]
    )
    lon, lat, confidence = (np.array(columns[number], float) for number in (5, 6, 8))
    order = np.lexsort((begins, objects, maps))
    begin = np.flatnonzero(np.diff(ids[order], prepend=-1))
    first, newest = order[begin], order[np.append(begin[1:], len(order))[: len(begin)] - 1]
    since = np.maximum.reduceat(renewed[order], begin) if len(begin) else renewed
    return KnownFeatures(
        maps[first],
        objects[first],
        ids[first],
        lon[first],
        lat[first],
        np.where(since > 0, since, begins[first]),
        np.array(columns[7], np.str_)[newest],
        confidence[newest],
    )


async def watches(connection: AsyncConnection, ids: Iterable[int]) -> dict[int, WatchReference]:
    """Return watch features by id, each with the candidate or map feature that it is now."""
    asked = sorted(set(ids))
    if not asked:
        return {}
    found = await connection.execute(
        text(f"""
        SELECT c.id, c.map_id, root.id AS candidate_id, root.feature_id,
               ST_X(COALESCE(p.geom, f.geom)) AS lon, ST_Y(COALESCE(p.geom, f.geom)) AS lat,
               COALESCE(c.id = c.merged_into, false) AS dissolved
        FROM {unnest({"id": "bigint"})}
        CROSS JOIN LATERAL (
            SELECT id, map_id, merged_into, COALESCE(merged_into, id) AS root, founding_pass FROM candidates
            WHERE id = r.id {PROBE}) c
        CROSS JOIN LATERAL (SELECT id, feature_id FROM candidates WHERE id = c.root {PROBE}) root
        LEFT JOIN passes p ON p.id = c.founding_pass
        LEFT JOIN LATERAL (
            SELECT geom FROM feature_versions WHERE feature_id = root.feature_id ORDER BY from_sequence LIMIT 1
        ) f ON p.id IS NULL
        WHERE p.id IS NOT NULL OR f.geom IS NOT NULL"""),  # noqa: S608  (constants)
        {"id": given("bigint", asked)},
    )
    return {row[0]: WatchReference(*row) for row in found.all()}
