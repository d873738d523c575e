"""POST /v1/evidence/retract, GET /v1/evidence/retractions, and undoing one."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query, Response, status

from slamcu_server.accounts.authentication import Admin
from slamcu_server.database.tables.columns import ID_MAX
from slamcu_server.database.transactions import DecisionTransaction, ReadTransaction
from slamcu_server.problems import responses
from slamcu_server.retraction import service
from slamcu_server.retraction.schemas import Retraction, RetractionPage, RetractionRequest, UndoRequest

router = APIRouter(prefix="/v1/evidence", tags=["administration"], responses=responses(401, 403))

RetractionId = Annotated[int, Path(ge=1, le=ID_MAX)]


@router.post(
    "/retract",
    status_code=status.HTTP_202_ACCEPTED,
    responses={**responses(404), 200: {"model": Retraction, "description": "A dry run, or a retraction that holds."}},
)
async def post_retract(
    admin: Admin, connection: DecisionTransaction, asked: RetractionRequest, response: Response
) -> Retraction:
    """Take evidence out, as if it had never been reported.

    202: the retraction is recorded and holds for every report that is aggregated from now on; the worker takes out
    what is stored, and features, candidates and changes become what they would be without it, which the feed tells.
    `GET /v1/evidence/retractions/{id}` says how far it is. 200: it was asked for before and still holds, or this is a
    dry run, which counts and changes nothing.

    It is exact within the retained window: beliefs become the fold of the passes that are kept and not taken out. A
    report that comes late and is named is taken out when it comes, until the retraction is undone; with `event_until`,
    what happened later counts. Map versions that a review has made are not unmade.
    """
    made, new = await service.request(connection, asked, admin)
    if not new:
        response.status_code = status.HTTP_200_OK
    return made


@router.get("/retractions")
async def get_retractions(
    _: Admin,
    connection: ReadTransaction,
    after: Annotated[int, Query(ge=0, le=ID_MAX, description="Retractions with greater ids.")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> RetractionPage:
    """List retractions, oldest first: what was taken out, by whom, when and why.

    Those of sessions that the server gated by itself are among them.
    """
    return await service.page(connection, after, limit)


@router.get("/retractions/{retraction_id}", responses=responses(404))
async def get_retraction(_: Admin, connection: ReadTransaction, retraction_id: RetractionId) -> Retraction:
    """Return a retraction and how far it is."""
    return await service.find(connection, retraction_id)


@router.post("/retractions/{retraction_id}/undo", status_code=status.HTTP_202_ACCEPTED, responses=responses(404))
async def post_undo(
    admin: Admin, connection: DecisionTransaction, retraction_id: RetractionId, asked: UndoRequest
) -> Retraction:
    """Let the evidence count again that a retraction took out, as far as it is still kept. Again changes nothing."""
    return await service.undo(connection, retraction_id, asked.reason, admin)
