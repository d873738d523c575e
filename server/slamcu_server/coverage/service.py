"""What the fleet has looked at, by tile."""

from __future__ import annotations

from typing import Any

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.accounts.times import TimesTold
from slamcu_server.changes.document import timestamp
from slamcu_server.coverage import repository
from slamcu_server.coverage.repository import CoverageQuery
from slamcu_server.maps.service import find_version
from slamcu_server.maps.tiles import tile_at, tile_bounds
from slamcu_server.problems import Problem


async def coverage(connection: AsyncConnection, query: CoverageQuery, times: TimesTold) -> dict[str, Any]:
    """Return the coverage of a map; answer 404 if there is no such map, 422 if the box has too many tiles."""
    await find_version(connection, query.scope, query.map_source)
    tiles = _tiles(query)
    if tiles > query.limit:
        detail = f"the box has {tiles} tiles at zoom {query.zoom}, at most {query.limit} can be asked for at once"
        raise Problem(422, "invalid-request", detail, errors=[{"field": "query.bbox", "detail": detail}])
    rows = await repository.count_by_tile(connection, query)
    return {
        "map": query.map_source,
        "zoom": query.zoom,
        "since": timestamp(query.since),
        "tiles": [
            {
                "z": query.zoom,
                "x": row.x,
                "y": row.y,
                "bbox": list(tile_bounds(query.zoom, row.x, row.y)),
                "features": row.features,
                "verified": row.verified,
                "looked_at": row.looked_at,
                "contradicted": row.contradicted,
                "never_looked": row.never_looked,
                "always_hidden": row.never_seen_past,
                "oldest_look": times.text(row.oldest_look),
                "newest_look": times.text(row.newest_look),
                "looks": row.looks,
                "could_not_see": row.could_not_see,
            }
            for row in rows
        ],
    }


def _tiles(query: CoverageQuery) -> int:
    """Return how many tiles the box touches."""
    box = query.bbox
    west, top = tile_at(query.zoom, box.west, box.north)
    east, bottom = tile_at(query.zoom, box.east, box.south)
    wide = east - west + 1 if box.west <= box.east else (1 << query.zoom) - west + east + 1
    return wide * (bottom - top + 1)
