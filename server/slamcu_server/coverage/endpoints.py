"""GET /v1/coverage."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import JSONResponse

from slamcu_server.accounts.authentication import Provider
from slamcu_server.coverage import service
from slamcu_server.coverage.repository import CoverageQuery
from slamcu_server.coverage.schemas import Coverage
from slamcu_server.database.transactions import ReadTransaction
from slamcu_server.instants import Instant
from slamcu_server.maps.bbox import BoundingBox, box_query
from slamcu_server.problems import responses

router = APIRouter(prefix="/v1/coverage", tags=["coverage"], responses=responses(401, 403))

TILES_MAX = 10_000
_SINCE = timedelta(days=30)


@router.get("", response_model=Coverage, responses=responses(404))
async def get_coverage(
    *,
    provider: Provider,
    connection: ReadTransaction,
    map_source: Annotated[str, Query(alias="map", description="The map's name.", max_length=200)],
    bbox: Annotated[str, box_query(f"At most {TILES_MAX} tiles.")],
    zoom: Annotated[int, Query(ge=0, le=20, description="Of the web-mercator tiles.")] = 14,
    since: Annotated[
        Instant | None,
        Query(description="What was seen from then on counts as verified; without it, 30 days ago."),
    ] = None,
) -> JSONResponse:
    """Tell what the fleet has looked at, by tile: what is verified need not be surveyed again."""
    since = provider.times.round(since or datetime.now(UTC) - _SINCE)
    query = CoverageQuery(map_source, zoom, BoundingBox.parse(bbox), since, TILES_MAX, provider.scope)
    return JSONResponse(await service.coverage(connection, query, provider.times))
