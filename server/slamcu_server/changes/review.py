"""Review: a provider accepts a change, which makes the next map version, or rejects it with a reason."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.accounts.schemas import Principal
from slamcu_server.aggregation import reads
from slamcu_server.aggregation.cells import Cell
from slamcu_server.aggregation.locks import BeyondLockedCells, lock_cells, require_cells
from slamcu_server.aggregation.refold import Touched, cells_of, refold
from slamcu_server.changes import feed, map_edit, repository, service
from slamcu_server.changes.belief import OPEN, Kind, State
from slamcu_server.changes.document import timestamp
from slamcu_server.changes.repository import StoredChange
from slamcu_server.changes.schemas import ReviewRequest
from slamcu_server.database.transactions import deciding
from slamcu_server.problems import Problem
from slamcu_server.trust.table import trusting


@dataclass(frozen=True, slots=True)
class _Asked:
    """A decision, the revisions that it may be about, and who decides."""

    decision: ReviewRequest
    tags: frozenset[str]
    reviewer: Principal


async def review(
    engine: AsyncEngine,
    policy: Policy,
    change_id: int,
    decision: ReviewRequest,
    *,
    if_match: str | None,
    reviewer: Principal,
) -> StoredChange:
    """Decide on a change, in one transaction under the locks that the worker takes too.

    Raises Problem 404 if there is no such change (of the reviewer's maps), 428 without If-Match, 412 if the change has
    another revision by now, and 409 if there is nothing to decide or the map version's name is taken; the database's
    error (503) if the locks are not to be had soon.
    """
    asked = _Asked(decision, _tags(if_match), reviewer)
    further: frozenset[Cell] = frozenset()
    while True:
        try:
            async with deciding(engine) as connection:
                return await _decide(connection, policy, change_id, asked, further)
        except BeyondLockedCells as beyond:
            further |= beyond.cells


async def _decide(
    connection: AsyncConnection,
    policy: Policy,
    change_id: int,
    asked: _Asked,
    further: frozenset[Cell],
) -> StoredChange:
    scope = asked.reviewer.scope
    change = await service.find_change(connection, scope, change_id)
    held = further | await _cells(connection, change, policy)
    await lock_cells(connection, held)
    change = await service.find_change(connection, scope, change_id)  # it may have moved on while we waited
    require_cells(await _cells(connection, change, policy), held)
    if change.etag not in asked.tags:
        detail = f"the change is at revision {change.revision}: look at it again and send its ETag {change.etag}"
        raise Problem(412, "revision-stale", detail, headers={"ETag": change.etag})
    if change.state not in OPEN:
        raise Problem(409, "not-reviewable", f"the change is {change.state}; there is nothing to decide")
    decision = asked.decision
    said: dict[str, Any] = {
        "decision": decision.decision,
        "reason": decision.reason,
        "by": asked.reviewer.label,
        "at": timestamp(datetime.now(UTC)),
        "map_version": None,
    }
    document = {**change.document, "review": said}
    accepted = decision.decision == "accept"
    edit = await _accept(connection, change, decision.version) if accepted else None
    if edit is not None:
        said["map_version"] = edit.version
        document |= {"map_object_id": edit.object_id, "mapped_at": said["at"], "mapped_in": edit.version}
    state = State.ACCEPTED if accepted else State.REJECTED
    reviewed = replace(change, state=state, revision=change.revision + 1, document=document)
    entry = feed.Entry(change.id, change.map_id, change.kind, state, reviewed.revision, document)
    # Before what else follows from the edit: this change is closed for it.
    await feed.revise(connection, [entry])
    await feed.settle(connection, [entry])
    entries: list[feed.Entry] = []
    if edit is not None:
        policy = await trusting(connection, policy)
        beliefs = await refold(connection, Touched(edit.features, edit.places), held, policy)
        entries = await feed.publish(connection, beliefs, policy)
    await feed.append(connection, [entry, *entries])
    return reviewed


async def _accept(connection: AsyncConnection, change: StoredChange, version: str | None) -> map_edit.MapEdit:
    """Write the next map version."""
    here = connection, change.map_id, change.id
    match change.kind, change.feature_id, change.candidate_id:
        case Kind.DELETED, int(feature), _:
            return await map_edit.remove_feature(*here, feature, version)
        case Kind.NEW, _, int(candidate):
            return await map_edit.add_feature(*here, candidate, version)
        case (Kind.MOVED | Kind.MODIFIED) as kind, int(feature), int(candidate):
            return await map_edit.replace_feature(*here, (feature, candidate), version, modified=kind is Kind.MODIFIED)
    raise Problem(409, "not-reviewable", f"the change of kind {change.kind} has lost what it is about")


async def _cells(connection: AsyncConnection, change: StoredChange, policy: Policy) -> frozenset[Cell]:
    """Return the cells of what a change is about: where it is published, and where its evidence is locked."""
    lon, lat = change.document["geometry"]["coordinates"][:2]
    places = [(change.map_id, lon, lat)]
    if change.candidate_id is not None:
        places.append((change.map_id, *await repository.founding_place(connection, change.candidate_id)))
    if change.feature_id is not None:
        places += await reads.anchors(connection, [change.feature_id])
    return cells_of(places, policy)


def _tags(if_match: str | None) -> frozenset[str]:
    if if_match is None or if_match.strip() == "*":
        detail = "a review needs the header If-Match with the ETag of the revision that was looked at"
        raise Problem(428, "revision-missing", detail)
    return frozenset(tag.strip() for tag in if_match.split(","))
