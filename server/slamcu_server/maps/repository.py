"""Maps, versions and features in the database."""

from __future__ import annotations

from typing import Any

from sqlalchemy import ColumnElement, Row, Select, and_, func, or_, select, text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.accounts.schemas import MapScope
from slamcu_server.database.tables import candidates, feature_versions, features, map_versions, maps
from slamcu_server.maps.bbox import BoundingBox


async def list_maps(connection: AsyncConnection, scope: MapScope) -> list[Row[Any]]:
    """Return every map of a scope with its current version and what that holds, by name.

    The box of a map on both sides of the antimeridian is the narrower of the two that hold it: its west may be greater
    than its east.
    """
    query = text("""
        SELECT source, version, sequence, count AS features, ST_YMin(box) AS south, ST_YMax(box) AS north,
            CASE WHEN across THEN ST_XMin(shifted) ELSE ST_XMin(box) END AS west,
            CASE WHEN across THEN ST_XMax(shifted) - 360 ELSE ST_XMax(box) END AS east
        FROM maps JOIN map_versions v ON v.map_id = maps.id AND v.sequence = maps.current_sequence
        CROSS JOIN LATERAL (
            SELECT count(*), ST_Extent(geom) AS box, ST_Extent(ST_ShiftLongitude(geom)) AS shifted
            FROM feature_versions f WHERE f.map_id = maps.id AND f.to_sequence IS NULL
        ) AS held
        CROSS JOIN LATERAL (
            SELECT ST_XMax(shifted) - ST_XMin(shifted) < ST_XMax(box) - ST_XMin(box)
                AND ST_XMin(shifted) < 180 AND ST_XMax(shifted) > 180 AS across
        ) AS narrower
        WHERE CAST(:sources AS text[]) IS NULL OR source = ANY(CAST(:sources AS text[]))
        ORDER BY source""")
    return list(await connection.execute(query, {"sources": scope.names()}))


async def find_version(connection: AsyncConnection, source: str, version: str | None) -> Row[Any] | None:
    """Return (map_id, source, version, sequence) of a version of a map, None: its current one."""
    columns = map_versions.c
    chosen = columns.sequence == maps.c.current_sequence if version is None else columns.version == version
    query: Select[Any] = (
        select(columns.map_id, maps.c.source, columns.version, columns.sequence)
        .join_from(maps, map_versions)
        .where(maps.c.source == source, chosen)
    )
    found: Row[Any] | None = (await connection.execute(query)).one_or_none()
    return found


async def list_versions(connection: AsyncConnection, map_id: int, after: int, limit: int) -> list[Row[Any]]:
    """Return up to `limit` versions of a map that follow the sequence `after`."""
    query = (
        select(map_versions)
        .where(map_versions.c.map_id == map_id, map_versions.c.sequence > after)
        .order_by(map_versions.c.sequence)
        .limit(limit)
    )
    return list(await connection.execute(query))


async def list_features(
    connection: AsyncConnection, map_id: int, sequence: int, *, bbox: BoundingBox | None, after: int, limit: int
) -> list[Row[Any]]:
    """Return up to `limit` features of a map version whose object ids follow `after`."""
    columns = feature_versions.c
    query: Select[Any] = (
        select(
            features.c.object_id,
            features.c.id.label("feature_id"),
            columns.feature_class,
            columns.sign,
            columns.value,
            columns.altitude,
            columns.heading_deg,
            columns.existence_confidence,
            columns.position_std_m,
            func.ST_X(columns.geom).label("lon"),
            func.ST_Y(columns.geom).label("lat"),
        )
        .join_from(feature_versions, features, columns.feature_id == features.c.id)
        .where(features.c.map_id == map_id, features.c.object_id > after, in_version(map_id, sequence))
        .order_by(features.c.object_id)
        .limit(limit)
    )
    if bbox is not None:
        query = query.where(bbox.contains(columns.geom))
    return list(await connection.execute(query))


async def list_watches(
    connection: AsyncConnection, map_id: int, *, bbox: BoundingBox | None, after: int, limit: int
) -> list[Row[Any]]:
    """Return up to `limit` open candidates of a map whose ids follow `after`.

    What has only been found in doubt, by fewer than are heard, is none that anybody should look for.
    """
    columns = candidates.c
    query: Select[Any] = (
        select(
            columns.id,
            columns.feature_class,
            columns.sign,
            columns.value,
            columns.cov_xx,
            columns.cov_xy,
            columns.cov_yy,
            func.ST_X(columns.geom).label("lon"),
            func.ST_Y(columns.geom).label("lat"),
            columns.pair_kind,
            features.c.object_id.label("pair_object_id"),
        )
        .outerjoin(features, features.c.id == columns.pair_feature_id)
        .where(columns.map_id == map_id, columns.id > after)
        .where(columns.merged_into.is_(None), columns.feature_id.is_(None), columns.first_seen.is_not(None))
        .order_by(columns.id)
        .limit(limit)
    )
    if bbox is not None:
        query = query.where(bbox.contains(columns.geom))
    return list(await connection.execute(query))


def in_version(map_id: int, sequence: int) -> ColumnElement[bool]:
    """Return the SQL condition that a row of feature_versions is part of a map version."""
    columns = feature_versions.c
    return and_(
        columns.map_id == map_id,
        columns.from_sequence <= sequence,
        or_(columns.to_sequence.is_(None), columns.to_sequence > sequence),
    )
