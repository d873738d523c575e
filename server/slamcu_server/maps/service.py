"""Pages of a map's features, and the tags that tell a vehicle that its copy is still good."""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, urlencode

from sqlalchemy import Row
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.accounts.schemas import MapScope
from slamcu_server.changes.belief import Kind
from slamcu_server.maps import repository
from slamcu_server.maps.bbox import BoundingBox
from slamcu_server.maps.tiles import tile_id, watch_tile_id
from slamcu_server.problems import Problem

_FORMAT = 2  # part of every ETag: raise it when the documents change
_WATCH = "watch-"


@dataclass(frozen=True, slots=True)
class Cursor:
    """Where a page begins: after a map feature's object id, or among the watch features, which come last."""

    watch: bool = False
    after: int = 0

    @classmethod
    def parse(cls, text: str | None) -> Cursor:
        """Read a cursor from a query parameter; answer 422 to what is none."""
        if text is None:
            return cls()
        match = re.fullmatch(rf"({_WATCH})?([0-9]{{1,18}})", text)
        if match is None:
            detail = "expected the `after` of a `next` link"
            errors = [{"field": "query.after", "detail": detail}]
            raise Problem(422, "invalid-request", f"query.after: {detail}", errors=errors)
        return cls(match[1] is not None, int(match[2]))

    def __str__(self) -> str:
        return f"{_WATCH if self.watch else ''}{self.after}"


@dataclass(frozen=True, slots=True)
class FeatureQuery:
    """Which features are asked for."""

    source: str
    version: str | None
    bbox: str | None
    after: str | None
    limit: int
    watch: bool
    scope: MapScope


async def find_version(
    connection: AsyncConnection, scope: MapScope, source: str, version: str | None = None
) -> Row[Any]:
    """Return (map_id, source, version, sequence); answer 404 if there is no such map or version in the scope."""
    if (found := await _find(connection, scope, source, version)) is not None:
        return found
    if version is None or await _find(connection, scope, source, None) is None:
        raise Problem(404, "unknown-map", f"there is no map {source[:200]!r}; GET /v1/maps names those there are")
    raise Problem(404, "unknown-map-version", f"map {source!r} has no version {version[:200]!r}")


async def _find(connection: AsyncConnection, scope: MapScope, source: str, version: str | None) -> Row[Any] | None:
    # No map has such a name, and the database refuses some of these characters.
    if source not in scope or not source.isprintable() or not (version or "").isprintable():
        return None
    return await repository.find_version(connection, source, version)


@dataclass(frozen=True, slots=True)
class FeaturePage:
    """A page of features, or that the asker's copy of it is still good (content None)."""

    etag: str
    content: bytes | None


async def feature_page(connection: AsyncConnection, query: FeatureQuery, known: str | None) -> FeaturePage:
    """Make a page, unless its tag is among the `known` ones (the header If-None-Match)."""
    bbox = BoundingBox.parse(query.bbox) if query.bbox is not None else None
    cursor = Cursor.parse(query.after)
    version = await find_version(connection, query.scope, query.source, query.version)
    watches: list[Row[Any]] = []
    if query.watch:
        after = cursor.after if cursor.watch else 0
        watches = await repository.list_watches(
            connection, version.map_id, bbox=bbox, after=after, limit=query.limit + 1
        )
    # Map features of one version never change, so the tag needs only the watch features from the database.
    etag = _tag(_FORMAT, version.map_id, version.sequence, bbox, cursor, query.limit, query.watch, watches)
    if known is not None and _knows(known, etag):
        return FeaturePage(etag, None)
    rows: list[Row[Any]] = []
    if not cursor.watch:
        rows = await repository.list_features(
            connection, version.map_id, version.sequence, bbox=bbox, after=cursor.after, limit=query.limit + 1
        )
    documents, following = _cut(rows, watches, query.limit)
    document = {
        "type": "FeatureCollection",
        "map": {"source": version.source, "version": version.version},
        "features": documents,
        "next": None if following is None else _link(query, version.version, following),
    }
    return FeaturePage(etag, json.dumps(document, separators=(",", ":"), allow_nan=False).encode())


def _cut(rows: list[Row[Any]], watches: list[Row[Any]], limit: int) -> tuple[list[dict[str, Any]], Cursor | None]:
    """Return the first `limit` documents, and where the next page begins if anything is left."""
    if len(rows) > limit:
        return [map_feature(row) for row in rows[:limit]], Cursor(after=rows[limit - 1].object_id)
    room = limit - len(rows)
    documents = [map_feature(row) for row in rows] + [watch_feature(row) for row in watches[:room]]
    if len(watches) <= room:
        return documents, None
    return documents, Cursor(watch=True, after=watches[room - 1].id if room else 0)


def map_feature(row: Row[Any]) -> dict[str, Any]:
    """Return a feature of a map version as GeoJSON."""
    place = [row.lon, row.lat] if row.altitude is None else [row.lon, row.lat, row.altitude]
    properties = {
        "class": row.feature_class,
        "sign": row.sign,
        "value": row.value,
        "heading_deg": row.heading_deg,
        "existence_confidence": row.existence_confidence,
        "position_std_m": row.position_std_m,
        "tile_id": tile_id(row.lon, row.lat),
        "feature_id": row.feature_id,
    }
    return _feature(row.object_id, place, properties)


def watch_feature(row: Row[Any]) -> dict[str, Any]:
    """Return an open candidate as the watch feature that vehicles check."""
    properties = {
        "class": row.feature_class,
        "sign": row.sign,
        "value": row.value,
        "position_std_m": round(math.sqrt((row.cov_xx + row.cov_yy) / 2), 3),
        "tile_id": watch_tile_id(row.lon, row.lat),
        "watch": True,
        "covariance_m2": [row.cov_xx, row.cov_xy, row.cov_yy],
        "kind": row.pair_kind or Kind.NEW.value,
        "replaces": row.pair_object_id,
    }
    return _feature(row.id, [row.lon, row.lat], properties)


def _feature(number: int, place: list[float], properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "id": number,
        "geometry": {"type": "Point", "coordinates": place},
        "properties": {name: value for name, value in properties.items() if value is not None},
    }


def _link(query: FeatureQuery, version: str, after: Cursor) -> str:
    """Return the address of the next page, of the same version even if there is a newer one by then."""
    parameters: dict[str, str | int] = {"version": version, "limit": query.limit, "after": str(after)}
    parameters["watch"] = str(query.watch).lower()
    if query.bbox is not None:
        parameters["bbox"] = query.bbox
    return f"/v1/maps/{quote(query.source, safe='')}/features?{urlencode(parameters)}"


def _tag(*parts: object) -> str:
    text = repr([[tuple(row) for row in part] if isinstance(part, list) else part for part in parts])
    return f'W/"{hashlib.sha256(text.encode()).hexdigest()[:32]}"'


def _knows(if_none_match: str, etag: str) -> bool:
    """Compare weakly (RFC 9110, section 13.1.2)."""
    opaque = etag.removeprefix("W/")
    return any(one.strip().removeprefix("W/") in {opaque, "*"} for one in if_none_match.split(","))
