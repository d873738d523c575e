"""Review: a provider accepts a change, which makes the next map version, or rejects it with a reason."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import reads
from slamcu_server.aggregation.cells import Cell
from slamcu_server.aggregation.locks import BeyondLockedCells, lock_cells, require_cells
from slamcu_server.aggregation.refold import Touched, cells_of, refold
from slamcu_server.changes import feed, map_edit, repository, service
from slamcu_server.changes.belief import REVIEWABLE, Kind, State
from slamcu_server.changes.document import timestamp
from slamcu_server.changes.repository import StoredChange
from slamcu_server.changes.schemas import ReviewRequest
from slamcu_server.problems import Problem


@dataclass(frozen=True, slots=True)
class _Asked:
    """A decision, the revisions that it may be about, and who decides."""

    decision: ReviewRequest
    tags: frozenset[str]
    reviewer: str


async def review(
    engine: AsyncEngine,
    policy: Policy,
    change_id: int,
    decision: ReviewRequest,
    *,
    if_match: str | None,
    reviewer: str,
) -> StoredChange:
    """Decide on a change, in one transaction under the locks that the worker takes too.

    Raises Problem 404 if there is no such change, 428 without If-Match, 412 if the change has another revision by
    now, and 409 if there is nothing to decide or the map version's name is taken.
    """
    asked = _Asked(decision, _tags(if_match), reviewer)
    further: frozenset[Cell] = frozenset()
    while True:
        try:
            async with engine.begin() as connection:
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
    change = await service.find_change(connection, change_id)
    held = further | await _cells(connection, change, policy)
    await lock_cells(connection, held)
    change = await service.find_change(connection, change_id)  # it may have moved on while we waited
    require_cells(await _cells(connection, change, policy), held)
    if change.etag not in asked.tags:
        detail = f"the change is at revision {change.revision}: look at it again and send its ETag {change.etag}"
        raise Problem(412, "revision-stale", detail, headers={"ETag": change.etag})
    if change.state not in REVIEWABLE:
        raise Problem(409, "not-reviewable", f"the change is {change.state}; there is nothing to decide")
    decision = asked.decision
    said: dict[str, Any] = {
        "decision": decision.decision,
        "reason": decision.reason,
        "by": asked.reviewer,
        "at": timestamp(datetime.now(UTC)),
        "map_version": None,
    }
    entries: list[feed.Entry] = []
    document = {**change.document, "review": said}
    if decision.decision == "accept":
        edit = await _accept(connection, change, decision.version)
        said["map_version"] = edit.version
        document["map_object_id"] = edit.object_id
        beliefs = await refold(connection, Touched(edit.features, edit.places), held, policy)
        entries += await feed.publish(connection, beliefs, policy)
    state = State.ACCEPTED if decision.decision == "accept" else State.REJECTED
    reviewed = replace(change, state=state, revision=change.revision + 1, document=document)
    entry = feed.Entry(change.id, change.map_id, change.kind, state, reviewed.revision, document)
    await feed.revise(connection, [entry])
    await feed.append(connection, [entry, *entries])
    return reviewed


async def _accept(connection: AsyncConnection, change: StoredChange, version: str | None) -> map_edit.MapEdit:
    """Write the next map version. `moved` and `modified` will be edits of a feature and its candidate together."""
    match change.kind:
        case Kind.DELETED if change.feature_id is not None:
            return await map_edit.remove_feature(connection, change.map_id, change.id, change.feature_id, version)
        case Kind.NEW if change.candidate_id is not None:
            return await map_edit.add_feature(connection, change.map_id, change.id, change.candidate_id, version)
    raise Problem(409, "not-reviewable", f"changes of kind {change.kind} cannot be accepted yet")


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
