"""Map features, their versions and what is believed about them, in the database."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Row, Select, func, or_, select, text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.accounts.schemas import MapScope
from slamcu_server.database.tables import feature_states, feature_versions, features, maps
from slamcu_server.maps.bbox import BoundingBox


async def find_feature(connection: AsyncConnection, feature_id: int) -> Row[Any] | None:
    """Return a feature as its newest version has it, with its state (columns are null if nobody reported)."""
    result = await connection.execute(
        text("""
        SELECT f.id, f.object_id, m.source, m.current_sequence, v.from_sequence, v.to_sequence, v.feature_class,
               v.sign, v.value, v.altitude, v.heading_deg, v.existence_confidence, v.position_std_m,
               ST_X(v.geom) AS lon, ST_Y(v.geom) AS lat, s.feature_id AS state_of, s.weight_for, s.weight_against,
               s.standing, s.contributors_for, s.contributors_against, s.passes, s.looked, s.blocked, s.last_looked,
               s.last_seen, s.last_informative, s.policy_version, s.fades_at, s.forgotten_looked, s.forgotten_blocked
        FROM features f
        JOIN maps m ON m.id = f.map_id
        JOIN feature_versions v ON v.feature_id = f.id
        LEFT JOIN feature_states s ON s.feature_id = f.id
        WHERE f.id = :id ORDER BY v.from_sequence DESC LIMIT 1"""),
        {"id": feature_id},
    )
    return result.one_or_none()


@dataclass(frozen=True, slots=True)
class LookQuery:
    """Which features are asked for."""

    map_source: str
    bbox: BoundingBox | None
    not_looked_since: datetime | None
    after: int
    limit: int
    scope: MapScope


async def list_looks(connection: AsyncConnection, query: LookQuery) -> list[Row[Any]]:
    """Return up to `limit` features of a map's current version whose ids follow `after`, with when they were seen."""
    state, version = feature_states.c, feature_versions.c
    chosen: Select[Any] = (
        select(
            features.c.id,
            features.c.object_id,
            version.feature_class,
            version.sign,
            version.value,
            func.ST_X(version.geom).label("lon"),
            func.ST_Y(version.geom).label("lat"),
            state.last_looked,
            state.last_seen,
            (func.coalesce(state.looked, 0) + func.coalesce(state.forgotten_looked, 0)).label("looked"),
            (func.coalesce(state.blocked, 0) + func.coalesce(state.forgotten_blocked, 0)).label("could_not_see"),
            func.coalesce(state.standing, False).label("stands_against"),
            state.fades_at,
        )
        .join_from(feature_versions, features, features.c.id == version.feature_id)
        .join(maps, maps.c.id == version.map_id)
        .outerjoin(feature_states, state.feature_id == version.feature_id)
        .where(maps.c.source == query.map_source, version.to_sequence.is_(None), features.c.id > query.after)
        .order_by(features.c.id)
        .limit(query.limit)
    )
    if query.bbox is not None:
        chosen = chosen.where(query.bbox.contains(version.geom))
    if query.not_looked_since is not None:
        chosen = chosen.where(or_(state.last_looked.is_(None), state.last_looked < query.not_looked_since))
    return list(await connection.execute(chosen))


async def find_id(connection: AsyncConnection, source: str, object_id: int) -> int | None:
    """Return the id of the feature that a map calls `object_id`."""
    result = await connection.execute(
        text("""
        SELECT f.id FROM features f JOIN maps m ON m.id = f.map_id
        WHERE m.source = :source AND f.object_id = :object"""),
        {"source": source, "object": object_id},
    )
    return result.scalar_one_or_none()


async def list_versions(connection: AsyncConnection, feature_id: int) -> list[Row[Any]]:
    """Return what the map's versions said about a feature, oldest first."""
    result = await connection.execute(
        text("""
        SELECT a.version AS since, b.version AS until, v.feature_class, v.sign, v.value, v.altitude, v.heading_deg,
               v.existence_confidence, v.position_std_m, ST_X(v.geom) AS lon, ST_Y(v.geom) AS lat
        FROM feature_versions v
        JOIN map_versions a ON a.map_id = v.map_id AND a.sequence = v.from_sequence
        LEFT JOIN map_versions b ON b.map_id = v.map_id AND b.sequence = v.to_sequence
        WHERE v.feature_id = :id ORDER BY v.from_sequence"""),
        {"id": feature_id},
    )
    return list(result)


async def list_changes(connection: AsyncConnection, feature_id: int) -> list[Row[Any]]:
    """Return the changes about a feature: that made it, or that it would be gone."""
    result = await connection.execute(
        text("""
        SELECT c.id, c.kind, c.state FROM changes c LEFT JOIN candidates k ON k.id = c.candidate_id
        WHERE c.feature_id = :id OR (k.feature_id = :id AND c.state IN ('accepted', 'absorbed')) ORDER BY c.id"""),
        {"id": feature_id},
    )
    return list(result)
