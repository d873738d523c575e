"""Features and what was looked at, counted by tile in the database."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import BigInteger, ColumnElement, Double, Integer, Row, and_, cast, func, select
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.accounts.schemas import MapScope
from slamcu_server.database.tables import feature_states, feature_versions, maps
from slamcu_server.maps.bbox import BoundingBox
from slamcu_server.maps.tiles import MAX_LAT


@dataclass(frozen=True, slots=True)
class CoverageQuery:
    """Which tiles are asked for."""

    map_source: str
    zoom: int
    bbox: BoundingBox
    since: datetime  # what was seen from then on counts as verified
    limit: int
    scope: MapScope


async def count_by_tile(connection: AsyncConnection, query: CoverageQuery) -> list[Row[Any]]:
    """Return for each tile with features of the map's current version, by x and y, what was looked at in it."""
    state, version = feature_states.c, feature_versions.c
    x, y = _tile(func.ST_X(version.geom), func.ST_Y(version.geom), query.zoom)
    looked = state.looked + state.forgotten_looked
    blocked = state.blocked + state.forgotten_blocked
    agrees = and_(state.last_seen >= query.since, state.standing.is_(False))
    faded = func.coalesce(state.fades_at <= func.now(), False)  # until the worker has said so
    counted = (
        select(
            x.label("x"),
            y.label("y"),
            func.count().label("features"),
            func.count().filter(agrees).label("verified"),
            func.count().filter(state.last_looked >= query.since).label("looked_at"),
            func.count().filter(and_(state.standing.is_(True), ~faded)).label("contradicted"),
            func.count().filter(state.last_looked.is_(None)).label("never_looked"),
            func.count().filter(and_(state.last_looked.is_(None), blocked > 0)).label("never_seen_past"),
            func.min(state.last_looked).label("oldest_look"),
            func.max(state.last_looked).label("newest_look"),
            cast(func.coalesce(func.sum(looked), 0), BigInteger).label("looks"),
            cast(func.coalesce(func.sum(blocked), 0), BigInteger).label("could_not_see"),
        )
        .select_from(feature_versions)
        .join(maps, maps.c.id == version.map_id)
        .outerjoin(feature_states, state.feature_id == version.feature_id)
        .where(maps.c.source == query.map_source, version.to_sequence.is_(None), query.bbox.contains(version.geom))
        .group_by(x, y)
        .order_by(x, y)
        .limit(query.limit)
    )
    return list(await connection.execute(counted))


def _tile(lon: ColumnElement[Any], lat: ColumnElement[Any], zoom: int) -> tuple[ColumnElement[int], ColumnElement[int]]:
    """Return x and y of the web-mercator tile in which a place lies, as `maps.tiles.tile_at` does."""
    size = float(1 << zoom)
    phi = func.radians(func.greatest(-MAX_LAT, func.least(MAX_LAT, lat)))
    x = func.floor(cast((lon + 180.0) / 360.0 * size, Double))
    y = func.floor((1.0 - func.asinh(func.tan(phi)) / func.pi()) / 2.0 * size)
    last = int(size) - 1
    return (
        cast(func.least(last, func.greatest(0, x)), Integer),
        cast(func.least(last, func.greatest(0, y)), Integer),
    )
