"""GET /v1/changes, GET /v1/changes/{id} and POST /v1/changes/{id}/review."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Path, Query, Request
from fastapi.responses import JSONResponse

from slamcu_server.accounts.authentication import Provider
from slamcu_server.aggregation.policy import load_policy
from slamcu_server.changes import review as reviewing
from slamcu_server.changes import service
from slamcu_server.changes.belief import Kind, State
from slamcu_server.changes.repository import FeedQuery
from slamcu_server.changes.schemas import Change, ExplainedChange, FeedPage, ReviewRequest
from slamcu_server.database.tables.columns import ID_MAX
from slamcu_server.database.transactions import EngineDependency, ReadTransaction
from slamcu_server.instants import Instant
from slamcu_server.maps.bbox import BoundingBox, box_query
from slamcu_server.problems import responses

router = APIRouter(prefix="/v1/changes", tags=["changes"], responses=responses(401, 403))

ChangeId = Annotated[int, Path(ge=1, le=ID_MAX)]


@router.get("", response_model=FeedPage)
async def get_changes(
    *,
    request: Request,
    provider: Provider,
    connection: ReadTransaction,
    after: Annotated[int, Query(ge=0, le=ID_MAX, description="Entries that follow this sequence number.")] = 0,
    bbox: Annotated[str | None, box_query()] = None,
    kind: Annotated[
        list[Kind],
        Query(description="Of these kinds only; may be repeated. A change may come to be of another kind."),
    ] = [],  # noqa: B006
    state: Annotated[
        list[State],
        Query(
            description="Only entries that said one of these; may be repeated. Leave it out to follow the feed: with "
            "`confirmed` alone you would never hear that a change was withdrawn."
        ),
    ] = [],  # noqa: B006
    map_source: Annotated[str | None, Query(alias="map", description="About this map only.", max_length=200)] = None,
    latest: Annotated[
        bool, Query(description="Only the newest entry of each change: what the service says now.")
    ] = False,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> JSONResponse:
    """Read the feed of changes in the order in which they were said.

    Sequence numbers have no gaps, and what is not visible yet comes after all that is: whoever asks on with `after`,
    and filters by neither `state` nor `kind`, misses nothing. A full page has a `next` link; from its end, ask on with
    `last_sequence`.
    """
    query = FeedQuery(
        after=after,
        limit=limit,
        scope=provider.scope,
        bbox=BoundingBox.parse(bbox) if bbox is not None else None,
        kinds=kind,
        states=state,
        map_source=map_source,
        latest=latest,
    )
    parameters = [(name, value) for name, value in request.query_params.multi_items() if name != "after"]
    return JSONResponse(await service.feed_page(connection, query, parameters, provider.times))


@router.get("/{change_id}", response_model=ExplainedChange, responses=responses(404))
async def get_change(
    provider: Provider,
    connection: ReadTransaction,
    change_id: ChangeId,
    as_of: Annotated[
        Instant | None,
        Query(
            description="Explain the evidence as of this time, as far as it is still kept; as of the end of the hour "
            "that it lies in, unless an admin asks."
        ),
    ] = None,
) -> JSONResponse:
    """Explain a change: as last published, the evidence behind it as it is now, and what would turn it.

    Of a moved or modified feature, `evidence` is about what is there now and `evidence_from` about what the map says.
    The `ETag` names the revision: send it as `If-Match` with a review.
    """
    change = await service.find_change(connection, provider.scope, change_id)
    explained = await service.explain_change(connection, change, provider.times, as_of)
    return JSONResponse(explained, headers={"ETag": change.etag})


@router.post("/{change_id}/review", response_model=Change, responses=responses(404, 409, 412, 428))
async def post_review(
    *,
    request: Request,
    provider: Provider,
    engine: EngineDependency,
    change_id: ChangeId,
    decision: ReviewRequest,
    if_match: Annotated[str | None, Header(description="The ETag of the revision that was looked at.")] = None,
) -> JSONResponse:
    """Accept a change, which makes the next version of the map, or reject it with a reason."""
    policy = load_policy(request.app.state.settings.policy_file)
    change = await reviewing.review(engine, policy, change_id, decision, if_match=if_match, reviewer=provider)
    return JSONResponse(service.present_change(change, provider.times), headers={"ETag": change.etag})
