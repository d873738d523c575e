"""GET /v1/features/{id}, and the way to it from a map's own ids."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path
from fastapi.responses import JSONResponse, RedirectResponse

from slamcu_server.accounts.authentication import Provider
from slamcu_server.database.engine import ReadTransaction
from slamcu_server.features import service
from slamcu_server.features.schemas import Feature
from slamcu_server.problems import responses

router = APIRouter(prefix="/v1", tags=["features"], responses=responses(401, 403))

_ID_MAX = 2**63 - 1


@router.get("/features/{feature_id}", response_model=Feature, responses=responses(404))
async def get_feature(
    _: Provider, connection: ReadTransaction, feature_id: Annotated[int, Path(ge=1, le=_ID_MAX)]
) -> JSONResponse:
    """Read a map feature: the evidence about it as it stands now, the map's versions of it, and its changes."""
    return JSONResponse(await service.find_feature(connection, feature_id))


@router.get(
    "/maps/{source}/features/{object_id}",
    response_class=RedirectResponse,
    status_code=307,
    responses=responses(404),
)
async def get_map_feature(
    _: Provider,
    connection: ReadTransaction,
    source: Annotated[str, Path(description="The map's name.", max_length=200)],
    object_id: Annotated[int, Path(ge=1, le=_ID_MAX, description="The map's own id.")],
) -> RedirectResponse:
    """Find the feature that a map calls `object_id`."""
    return RedirectResponse(f"/v1/features/{await service.find_id(connection, source, object_id)}", 307)
