"""Edits of a map that a review makes: each one is a version of the map."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.hd_map import MapFeature
from slamcu_server.problems import Problem

Places = frozenset[tuple[int, float, float]]

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
    return MapEdit(following.version, object_id, frozenset(), frozenset())


async def add_feature(
    connection: AsyncConnection, map_id: int, change_id: int, candidate_id: int, version: str | None
) -> MapEdit:
    """Make the map version in which a candidate is a feature.

    The feature starts from its prior: the passes that made the candidate are archived, so that nothing counts twice.
    """
    following = await _lock_next(connection, map_id, version)
    candidate = (
        await connection.execute(
            text("""
            SELECT feature_class, sign, value, cov_xx, cov_yy, ST_X(geom) AS lon, ST_Y(geom) AS lat FROM candidates
            WHERE id = :id AND feature_id IS NULL AND merged_into IS NULL"""),
            {"id": candidate_id},
        )
    ).one_or_none()
    if candidate is None:
        raise Problem(409, "not-reviewable", "the candidate is part of another one, or in the map already")
    created = await connection.execute(
        text("INSERT INTO features (map_id, object_id) VALUES (:map, :object) RETURNING id"),
        {"map": map_id, "object": following.object_id},
    )
    feature_id = int(created.scalar_one())
    await connection.execute(
        text("""
        INSERT INTO feature_versions (feature_id, from_sequence, map_id, feature_class, sign, value,
            existence_confidence, position_std_m, geom)
        VALUES (:feature, :sequence, :map, :class, :sign, :value, :confidence, :std,
            ST_SetSRID(ST_MakePoint(:lon, :lat), 4326))"""),
        {
            "feature": feature_id,
            "sequence": following.sequence,
            "map": map_id,
            "class": candidate.feature_class,
            "sign": candidate.sign,
            "value": candidate.value,
            "confidence": EXISTENCE_CONFIDENCE,
            "std": math.sqrt((candidate.cov_xx + candidate.cov_yy) / 2),
            "lon": candidate.lon,
            "lat": candidate.lat,
        },
    )
    await connection.execute(
        text("UPDATE candidates SET feature_id = :feature WHERE id = :id"),
        {"feature": feature_id, "id": candidate_id},
    )
    places = await _archive_passes(connection, candidate_id)
    await _write_version(connection, map_id, change_id, following, next_object_id=following.object_id + 1)
    return MapEdit(following.version, following.object_id, frozenset({feature_id}), places)


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
        imported = await connection.execute(
            text("""
            SELECT version, sequence FROM map_versions
            WHERE map_id = :map AND origin = 'import' ORDER BY sequence DESC LIMIT 1"""),
            {"map": map_id},
        )
        base = imported.one()
        version = f"{base.version}+{sequence - base.sequence}"
    taken = await connection.execute(
        text("SELECT sequence FROM map_versions WHERE map_id = :map AND version = :version"),
        {"map": map_id, "version": version},
    )
    if taken.one_or_none() is not None:
        raise Problem(409, "map-version-taken", f"the map has a version {version!r} already")
    return _NextVersion(sequence, version, row.next_object_id)


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
