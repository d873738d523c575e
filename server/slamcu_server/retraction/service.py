"""Ask for a retraction, look at it, and undo it; the worker applies it."""

from __future__ import annotations

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.accounts import repository as accounts
from slamcu_server.accounts.schemas import Principal
from slamcu_server.aggregation import log
from slamcu_server.problems import Problem
from slamcu_server.retraction import marks, repository
from slamcu_server.retraction.filter import FIELDS, EvidenceFilter
from slamcu_server.retraction.repository import State, StoredRetraction
from slamcu_server.retraction.schemas import Retraction, RetractionPage, RetractionRequest, Selection

_DONE = frozenset({State.UNDO_REQUESTED, State.UNDOING, State.UNDONE})


async def request(connection: AsyncConnection, asked: RetractionRequest, by: Principal) -> tuple[Retraction, bool]:
    """Record a retraction, and return it and whether it is a new one: the same again is the same one."""
    names = await _names(connection, asked)
    if asked.dry_run:
        extent = await repository.measure(connection, names)
        return Retraction(
            id=None,
            state=None,
            selection=_selection(names, asked.contributor),
            reason=asked.reason,
            requested_by=by.label,
            passes=extent.passes,
            features=extent.features,
            candidates=extent.candidates,
        ), False
    await marks.hold_alone(connection)
    active = await repository.find_active(connection, names)
    if active is not None:
        return present(active), False
    made = await repository.add(connection, names, asked.reason, by.account_id)
    await log.call(connection)
    return present(await _find(connection, made)), True


async def undo(connection: AsyncConnection, retraction_id: int, reason: str, by: Principal) -> Retraction:
    """Let a retraction hold no longer; to undo it again changes nothing."""
    await marks.hold_alone(connection)
    found = await _find(connection, retraction_id)
    if found.state not in _DONE:
        await repository.request_undo(connection, retraction_id, reason, by.account_id)
        await log.call(connection)
        found = await _find(connection, retraction_id)
    return present(found)


async def find(connection: AsyncConnection, retraction_id: int) -> Retraction:
    """Return a retraction; answer 404 if there is none."""
    return present(await _find(connection, retraction_id))


async def page(connection: AsyncConnection, after: int, limit: int) -> RetractionPage:
    """Return a page of retractions."""
    found = await repository.list_after(connection, after, limit + 1)
    shown = found[:limit]
    following = f"/v1/evidence/retractions?limit={limit}&after={shown[-1].id}" if len(found) > limit else None
    return RetractionPage(retractions=[present(one) for one in shown], next=following)


def present(stored: StoredRetraction) -> Retraction:
    """Return the document of a retraction."""
    return Retraction(
        id=stored.id,
        state=stored.state,
        selection=_selection(stored.names, stored.contributor),
        reason=stored.reason,
        requested_by=stored.requested_by,
        requested_at=stored.requested_at,
        applied_at=stored.applied_at,
        passes=stored.passes,
        features=stored.features,
        candidates=stored.candidates,
        put_aside=stored.put_aside,
        undo_reason=stored.undo_reason,
        undone_by=stored.undone_by,
        undone_at=stored.undone_at,
    )


async def _find(connection: AsyncConnection, retraction_id: int) -> StoredRetraction:
    found = await repository.find(connection, retraction_id)
    if found is None:
        raise Problem(404, "unknown-retraction", f"there is no retraction {retraction_id}")
    return found


async def _names(connection: AsyncConnection, asked: Selection) -> EvidenceFilter:
    contributor_id = None
    if asked.contributor is not None:
        account = await accounts.find_account(connection, asked.contributor)
        if account is None:
            raise Problem(404, "unknown-account", f"there is no account {asked.contributor!r}")
        contributor_id = account[0]
    given = {name: getattr(asked, name) for name in FIELDS if name != "contributor_id"}
    return EvidenceFilter(contributor_id=contributor_id, **given)


def _selection(names: EvidenceFilter, contributor: str | None) -> Selection:
    given = {name: getattr(names, name) for name in FIELDS if name != "contributor_id"}
    return Selection(contributor=contributor, **given)
