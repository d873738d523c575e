"""GET /v1/maps, its versions and its features."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import quote, urlencode

from fastapi import APIRouter, Header, Path, Query, Response
from fastapi.responses import JSONResponse

from slamcu_server.accounts.authentication import MapReader
from slamcu_server.accounts.schemas import Role
from slamcu_server.database.transactions import ReadTransaction
from slamcu_server.maps import repository, service
from slamcu_server.maps.bbox import box_query
from slamcu_server.maps.schemas import FeaturePage, MapList, MapSummary, MapVersion, MapVersionPage
from slamcu_server.problems import responses

router = APIRouter(prefix="/v1/maps", tags=["maps"], responses=responses(401, 403))

MapName = Annotated[str, Path(description="The map's name (its source).", max_length=200)]
_SEQUENCE_MAX = 2**31 - 1


class GeoJSONResponse(JSONResponse):
    """A response in GeoJSON that is rendered already; the API's description has the schema of its content."""

    media_type = "application/geo+json"

    def render(self, content: bytes) -> bytes:
        """Return the content as it is."""
        return content


@router.get("")
async def get_maps(reader: MapReader, connection: ReadTransaction) -> MapList:
    """List the maps with their current versions; a key that is bound to maps has to do with these only."""
    rows = await repository.list_maps(connection, reader.scope)
    return MapList(
        maps=[
            MapSummary(
                source=row.source,
                version=row.version,
                sequence=row.sequence,
                features=row.features,
                bbox=None if row.west is None else (row.west, row.south, row.east, row.north),
            )
            for row in rows
        ]
    )


@router.get("/{source}/versions", responses=responses(404))
async def get_versions(
    reader: MapReader,
    connection: ReadTransaction,
    source: MapName,
    after: Annotated[int, Query(ge=0, le=_SEQUENCE_MAX, description="Versions that follow this sequence.")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> MapVersionPage:
    """List the versions of a map, oldest first."""
    found = await service.find_version(connection, reader.scope, source)
    rows = await repository.list_versions(connection, found.map_id, after, limit + 1)
    versions = [MapVersion.model_validate(row, from_attributes=True) for row in rows[:limit]]
    following = None
    if len(rows) > limit:
        parameters = urlencode({"limit": limit, "after": versions[-1].sequence})
        following = f"/v1/maps/{quote(source, safe='')}/versions?{parameters}"
    return MapVersionPage(versions=versions, next=following)


@router.get(
    "/{source}/features",
    response_class=GeoJSONResponse,
    response_model=FeaturePage,
    responses={304: {"description": "Your copy is still good."}, **responses(404)},
)
async def get_features(
    *,
    reader: MapReader,
    connection: ReadTransaction,
    source: MapName,
    bbox: Annotated[str | None, box_query("Without it, the whole map.")] = None,
    version: Annotated[str | None, Query(description="Without it, the current one.", max_length=200)] = None,
    limit: Annotated[int, Query(ge=1, le=10_000, description="Features in a page.")] = 1000,
    after: Annotated[str | None, Query(description="From the `next` link of the page before.", max_length=40)] = None,
    watch: Annotated[
        bool | None,
        Query(description="Whether watch features come along. Without it, they do for a vehicle's key only."),
    ] = None,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """Fetch the features of a map version, page by page.

    All pages that a `next` link leads to are of the same version. Send the `ETag` of your copy of a page as
    `If-None-Match`: the answer is 304 as long as it is good.
    """
    with_watches = reader.role is Role.VEHICLE if watch is None else watch
    query = service.FeatureQuery(source, version, bbox, after, limit, with_watches, reader.scope)
    page = await service.feature_page(connection, query, if_none_match)
    headers = {"ETag": page.etag, "Cache-Control": "private, no-cache", "Vary": "Authorization"}
    if page.content is None:
        return Response(status_code=304, headers=headers)
    return GeoJSONResponse(page.content, headers=headers)
