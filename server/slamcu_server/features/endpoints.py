"""GET /v1/features, GET /v1/features/{id}, and the way to it from a map's own ids."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import JSONResponse, RedirectResponse

from slamcu_server.accounts.authentication import Provider
from slamcu_server.database.tables.columns import ID_MAX
from slamcu_server.database.transactions import ReadTransaction
from slamcu_server.features import service
from slamcu_server.features.repository import LookQuery
from slamcu_server.features.schemas import Feature, LookPage
from slamcu_server.instants import Instant
from slamcu_server.maps.bbox import BoundingBox, box_query
from slamcu_server.problems import responses

router = APIRouter(prefix="/v1", tags=["features"], responses=responses(401, 403))


@router.get("/features", response_model=LookPage, responses=responses(404))
async def get_features(
    *,
    request: Request,
    provider: Provider,
    connection: ReadTransaction,
    map_source: Annotated[str, Query(alias="map", description="The map's name.", max_length=200)],
    bbox: Annotated[str | None, box_query()] = None,
    not_looked_since: Annotated[
        Instant | None, Query(description="Only those that nobody has looked at since then.")
    ] = None,
    after: Annotated[int, Query(ge=0, le=ID_MAX, description="Features with greater ids.")] = 0,
    limit: Annotated[int, Query(ge=1, le=10_000)] = 1000,
) -> JSONResponse:
    """List the features of a map's current version with when they were last looked at and seen, and how often."""
    box = None if bbox is None else BoundingBox.parse(bbox)
    since = None if not_looked_since is None else provider.times.round(not_looked_since)
    query = LookQuery(map_source, box, since, after, limit, provider.scope)
    parameters = [(name, value) for name, value in request.query_params.multi_items() if name != "after"]
    return JSONResponse(await service.look_page(connection, query, parameters, provider.times))


@router.get("/features/{feature_id}", response_model=Feature, responses=responses(404))
async def get_feature(
    provider: Provider, connection: ReadTransaction, feature_id: Annotated[int, Path(ge=1, le=ID_MAX)]
) -> JSONResponse:
    """Read a map feature: the evidence about it as it stands now, the map's versions of it, and its changes."""
    return JSONResponse(await service.find_feature(connection, provider, feature_id))


@router.get(
    "/maps/{source}/features/{object_id}",
    response_class=RedirectResponse,
    status_code=307,
    responses=responses(404),
)
async def get_map_feature(
    provider: Provider,
    connection: ReadTransaction,
    source: Annotated[str, Path(description="The map's name.", max_length=200)],
    object_id: Annotated[int, Path(ge=1, le=ID_MAX, description="The map's own id.")],
) -> RedirectResponse:
    """Find the feature that a map calls `object_id`."""
    return RedirectResponse(f"/v1/features/{await service.find_id(connection, provider.scope, source, object_id)}", 307)
