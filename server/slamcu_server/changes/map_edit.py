"""Edits of a map that a review makes: each one is a version of the map."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.hd_map import MapFeature
from slamcu_server.aggregation.refold import Places
from slamcu_server.problems import Problem

EXISTENCE_CONFIDENCE = MapFeature(object_id=1, lon=0.0, lat=0.0).existence_confidence
"""λ_HD of an accepted feature: from then on the map says so, like of any other."""


@dataclass(frozen=True, slots=True)
class MapEdit:
    """What an edit did, and what has to be folded again."""

    version: str
    object_id: int
    features: frozenset[int]
    places: Places


@dataclass(frozen=True, slots=True)
class _NextVersion:
    sequence: int
    version: str
    object_id: int  # the next that is free


async def remove_feature(
    connection: AsyncConnection, map_id: int, change_id: int, feature_id: int, version: str | None
) -> MapEdit:
    """Make the map version without a feature. Its id is never used again; evidence about it goes on being kept."""
    following = await _lock_next(connection, map_id, version)
    result = await connection.execute(
        text("""
        UPDATE feature_versions v SET to_sequence = :sequence FROM features f
        WHERE f.id = v.feature_id AND f.id = :feature AND v.to_sequence IS NULL RETURNING f.object_id"""),
        {"sequence": following.sequence, "feature": feature_id},
    )
    object_id = result.scalar_one_or_none()
    if object_id is None:
        raise Problem(409, "not-in-map", "the feature is no longer in the map's current version")
    await _write_version(connection, map_id, change_id, following, next_object_id=following.object_id)
    return MapEdit(following.version, object_id, frozenset({feature_id}), frozenset())


async def add_feature(
    connection: AsyncConnection, map_id: int, change_id: int, candidate_id: int, version: str | None
) -> MapEdit:
    """Make the map version in which a candidate is a feature.

    The feature starts from its prior: the passes that made the candidate are archived, so that nothing counts twice.
    """
    following = await _lock_next(connection, map_id, version)
    candidate = await _candidate(connection, candidate_id)
    created = await connection.execute(
        text("INSERT INTO features (map_id, object_id) VALUES (:map, :object) RETURNING id"),
        {"map": map_id, "object": following.object_id},
    )
    feature_id = int(created.scalar_one())
    await connection.execute(
        text("""
        INSERT INTO feature_versions (feature_id, from_sequence, evidence_sequence, map_id, feature_class, sign, value,
            existence_confidence, position_std_m, geom)
        VALUES (:feature, :sequence, :sequence, :map, :class, :sign, :value, :confidence, :std,
            ST_SetSRID(ST_MakePoint(:lon, :lat), 4326))"""),
        {
            "feature": feature_id,
            "sequence": following.sequence,
            "map": map_id,
            "class": candidate.feature_class,
            "sign": candidate.sign,
            "value": candidate.value,
            "confidence": EXISTENCE_CONFIDENCE,
            "std": _std(candidate),
            "lon": candidate.lon,
            "lat": candidate.lat,
        },
    )
    places = await become(connection, candidate_id, feature_id)
    await _write_version(connection, map_id, change_id, following, next_object_id=following.object_id + 1)
    half = {candidate.pair_feature_id} - {None}  # it has lost the other
    return MapEdit(following.version, following.object_id, frozenset({feature_id, *half}), places)


async def replace_feature(
    connection: AsyncConnection,
    map_id: int,
    change_id: int,
    ends: tuple[int, int],
    version: str | None,
    *,
    modified: bool,
) -> MapEdit:
    """Make the map version in which a feature is what its candidate (`ends`: their ids) says, and keeps its object id.

    A moved one goes to the candidate's place, as well as that is known. A modified one stays where it was surveyed and
    says what the candidate says. What was reported about the feature before and about the candidate is archived.
    """
    feature_id, candidate_id = ends
    following = await _lock_next(connection, map_id, version)
    candidate = await _candidate(connection, candidate_id)
    ended = await connection.execute(
        text("""
        UPDATE feature_versions v SET to_sequence = :sequence FROM features f
        WHERE f.id = v.feature_id AND f.id = :feature AND v.to_sequence IS NULL RETURNING f.object_id"""),
        {"sequence": following.sequence, "feature": feature_id},
    )
    object_id = ended.scalar_one_or_none()
    if object_id is None:
        raise Problem(409, "not-in-map", "the feature is no longer in the map's current version")
    place, thing = _MODIFIED if modified else _MOVED
    await connection.execute(
        text(f"""
        INSERT INTO feature_versions (feature_id, from_sequence, evidence_sequence, map_id, feature_class, altitude,
            heading_deg, existence_confidence, sign, value, position_std_m, geom)
        SELECT feature_id, :sequence, :sequence, map_id, feature_class, altitude, heading_deg, :confidence, {thing},
            {place}
        FROM feature_versions WHERE feature_id = :feature AND to_sequence = :sequence"""),  # noqa: S608  (constants)
        {
            "feature": feature_id,
            "sequence": following.sequence,
            "confidence": EXISTENCE_CONFIDENCE,
            "sign": candidate.sign,
            "value": candidate.value,
            "std": _std(candidate),
            "lon": candidate.lon,
            "lat": candidate.lat,
        },
    )
    await archive_feature_passes(connection, [feature_id])
    places = await become(connection, candidate_id, feature_id)
    await _write_version(connection, map_id, change_id, following, next_object_id=following.object_id)
    return MapEdit(following.version, object_id, frozenset({feature_id}), places)


_MOVED = (
    "CAST(:std AS float8), ST_SetSRID(ST_MakePoint(:lon, :lat), 4326)",
    "COALESCE(sign, CAST(:sign AS text)), COALESCE(value, CAST(:value AS text))",
)
_MODIFIED = ("position_std_m, geom", "COALESCE(CAST(:sign AS text), sign), CAST(:value AS text)")


async def become(connection: AsyncConnection, candidate_id: int, feature_id: int) -> Places:
    """Let a candidate be a map feature from now on, and return the places near which others may be clustered anew."""
    await connection.execute(
        text("""
        UPDATE candidates SET feature_id = :feature, pair_feature_id = NULL, pair_kind = NULL WHERE id = :id"""),
        {"feature": feature_id, "id": candidate_id},
    )
    return await _archive_passes(connection, candidate_id)


async def archive_feature_passes(connection: AsyncConnection, ids: Iterable[int]) -> None:
    """Archive what was reported about features as they were: it says nothing about what they are now."""
    await connection.execute(
        text("UPDATE passes SET archived = true WHERE feature_id = ANY(CAST(:ids AS bigint[])) AND NOT archived"),
        {"ids": sorted(set(ids))},
    )


async def _candidate(connection: AsyncConnection, candidate_id: int) -> Row[Any]:
    found = await connection.execute(
        text("""
        SELECT feature_class, sign, value, cov_xx, cov_yy, ST_X(geom) AS lon, ST_Y(geom) AS lat, pair_feature_id
        FROM candidates
        WHERE id = :id AND feature_id IS NULL AND merged_into IS NULL"""),
        {"id": candidate_id},
    )
    candidate: Row[Any] | None = found.one_or_none()
    if candidate is None:
        raise Problem(409, "not-reviewable", "the candidate is part of another one, or in the map already")
    return candidate


def _std(candidate: Row[Any]) -> float:
    return math.sqrt((candidate.cov_xx + candidate.cov_yy) / 2)


async def _archive_passes(connection: AsyncConnection, candidate_id: int) -> Places:
    """Archive what counted for a candidate, and return the places near which others may have to be clustered anew."""
    result = await connection.execute(
        text("""
        UPDATE passes SET archived = true WHERE candidate_id = :id
        RETURNING map_id, watch_id, ST_X(geom) AS lon, ST_Y(geom) AS lat"""),
        {"id": candidate_id},
    )
    return frozenset((row.map_id, row.lon, row.lat) for row in result if row.watch_id is None and row.lon is not None)


async def _lock_next(connection: AsyncConnection, map_id: int, version: str | None) -> _NextVersion:
    """Hold a map against other writers and return its next version."""
    # Not FOR UPDATE: that would also wait for every batch that stores passes over this map.
    result = await connection.execute(
        text("SELECT current_sequence, next_object_id FROM maps WHERE id = :map FOR NO KEY UPDATE"), {"map": map_id}
    )
    row = result.one()
    sequence = row.current_sequence + 1
    if version is None:
        version = await _free_name(connection, map_id, sequence)
    elif await _has_version(connection, map_id, version):
        raise Problem(409, "map-version-taken", f"the map has a version {version!r} already")
    return _NextVersion(sequence, version, row.next_object_id)


async def _free_name(connection: AsyncConnection, map_id: int, sequence: int) -> str:
    """Return the first name that is free: the imported version's, and how many reviews have edited it."""
    imported = await connection.execute(
        text("""
        SELECT version, sequence FROM map_versions
        WHERE map_id = :map AND origin = 'import' ORDER BY sequence DESC LIMIT 1"""),
        {"map": map_id},
    )
    base = imported.one()
    number = sequence - base.sequence
    # a review may have given such a name to its version
    while await _has_version(connection, map_id, name := f"{base.version}+{number}"):
        number += 1
    return name


async def _has_version(connection: AsyncConnection, map_id: int, version: str) -> bool:
    query = text("SELECT EXISTS (SELECT FROM map_versions WHERE map_id = :map AND version = :version)")
    return bool((await connection.execute(query, {"map": map_id, "version": version})).scalar_one())


async def _write_version(
    connection: AsyncConnection, map_id: int, change_id: int, following: _NextVersion, *, next_object_id: int
) -> None:
    await connection.execute(
        text("""
        INSERT INTO map_versions (map_id, sequence, version, origin, change_id)
        VALUES (:map, :sequence, :version, 'review', :change)"""),
        {"map": map_id, "sequence": following.sequence, "version": following.version, "change": change_id},
    )
    await connection.execute(
        text("UPDATE maps SET current_sequence = :sequence, next_object_id = :next WHERE id = :map"),
        {"map": map_id, "sequence": following.sequence, "next": next_object_id},
    )
