"""One batch: messages, their passes and all that follows from them, in one transaction.

Locks come before reads, and reads are new statements (READ COMMITTED), so a batch sees everything that those before it
wrote about its cells. The appending to the feed comes last, because all batches wait for each other there.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_core.errors import SlamcuError
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import decode_message
from slamcu_server.aggregation import log, quiet, reads, writes
from slamcu_server.aggregation.cells import Cell
from slamcu_server.aggregation.locks import CELL_BUDGET, BeyondLockedCells, lock_cells, require_cells
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.aggregation.refold import Places, Touched, cells_of, refold
from slamcu_server.aggregation.resolve import (
    ClaimedMessage,
    Lookups,
    ResolvedMessage,
    match_feature,
    resolve_message,
    within_budget,
)
from slamcu_server.changes import feed
from slamcu_server.retraction import marks
from slamcu_server.trust.table import trusting


@dataclass(frozen=True, slots=True)
class Fused:
    """What one batch did."""

    fused: int = 0
    quarantined: int = 0

    @property
    def messages(self) -> int:
        """How many messages do not wait any more."""
        return self.fused + self.quarantined


class BatchError(Exception):
    """A batch failed and left no trace; its cause says why."""

    def __init__(self, ids: Sequence[int]) -> None:
        super().__init__(f"a batch of {len(ids)} messages failed")
        self.ids = tuple(ids)


async def process_batch(engine: AsyncEngine, policy: Policy, *, limit: int, ids: Sequence[int] | None = None) -> Fused:
    """Fuse up to `limit` pending messages (of `ids`, if given) and return what was done.

    Raises BatchError, with the messages it is about, for whatever went wrong after they were claimed.
    """
    further: frozenset[Cell] = frozenset()
    while True:
        claimed: list[ClaimedMessage] = []
        try:
            async with engine.begin() as connection:
                claimed += await log.claim(connection, limit, ids)
                return await _fuse(connection, claimed, policy, further) if claimed else Fused()
        except BeyondLockedCells as beyond:
            further |= beyond.cells  # another try that holds these too, from the start, so that keys stay in order
        except Exception as error:
            if not claimed:
                raise
            raise BatchError([message.id for message in claimed]) from error


async def quarantine(engine: AsyncEngine, message_id: int, reason: str) -> None:
    """Put one message aside, if it is still pending and nobody else holds it."""
    async with engine.begin() as connection:
        claimed = await log.claim(connection, 1, [message_id])
        await log.quarantine(connection, {message.id: reason for message in claimed})


async def _fuse(
    connection: AsyncConnection, claimed: Sequence[ClaimedMessage], policy: Policy, further: frozenset[Cell]
) -> Fused:
    retractions = await marks.hold(connection)
    policy = await trusting(connection, policy)
    reports, reasons = await asyncio.to_thread(_decode, claimed)
    known = await reads.lookups(connection, reports.values())
    resolved, unresolvable = _resolve(claimed, reports, known)
    reasons |= unresolvable
    taken, cells = within_budget(resolved, policy.lock_reach_m, CELL_BUDGET, further)
    if taken:
        # Nobody sees these before the commit, so they need no lock: other batches fold meanwhile.
        plain = await _store_plain(connection, taken, retractions=retractions)
        await log.mark_fused(connection, (message.claimed.id for message in taken))
        await lock_cells(connection, cells)
        # What candidates are may have changed while waiting: another batch can have merged them, a review
        # accepted them.
        taken, known = await _look_again(connection, taken, known)
        others = await _store_others(connection, taken, cells, policy, retractions=retractions)
        loud = await quiet.append(connection, [*plain, *others], policy)
        beliefs = await refold(connection, Touched(loud, *_candidates(others, known)), cells, policy)
        entries = await feed.publish(connection, beliefs, policy)
    else:
        entries = []
    await log.quarantine(connection, reasons)
    await feed.append(connection, entries)
    return Fused(len(taken), len(reasons))


async def _look_again(
    connection: AsyncConnection, messages: Sequence[ResolvedMessage], known: Lookups
) -> tuple[list[ResolvedMessage], Lookups]:
    """Return messages with what their passes are about now that the cells are held.

    Raises BeyondLockedCells, to start over, if a pass that is stored already counts otherwise than it did.
    """
    again = await reads.lookups_again(connection, known)
    if again == known:
        return list(messages), again
    resolved = [resolve_message(message.claimed, message.report, again) for message in messages]
    for before, after in zip(messages, resolved, strict=True):
        if any(one.archived is not other.archived for one, other in zip(before.passes, after.passes, strict=True)):
            raise BeyondLockedCells(frozenset())
    return resolved, again


async def _store_plain(
    connection: AsyncConnection, messages: Sequence[ResolvedMessage], *, retractions: bool
) -> list[StoredPass]:
    """Store the passes that name map features, and return those that no retraction takes out."""
    plain = [_only(message, plain=True) for message in messages]
    if retractions:
        return await _marked(connection, await writes.insert_passes(connection, plain))
    await writes.copy_passes(connection, plain)
    return [item for message in plain for item in message.passes]


async def _store_others(
    connection: AsyncConnection,
    messages: Sequence[ResolvedMessage],
    held: frozenset[Cell],
    policy: Policy,
    *,
    retractions: bool,
) -> list[StoredPass]:
    """Store the other passes, with what they turn out to be about, and return those that no retraction takes out."""
    require_cells(cells_of((anchor for message in messages for anchor in message.anchors), policy), held)
    others = await _match(connection, [_only(message, plain=False) for message in messages], policy)
    matched = {item.feature_id for message in others for item in message.passes if item.feature_id is not None}
    require_cells(cells_of(await reads.anchors(connection, matched), policy), held)
    passes = await writes.insert_passes(connection, others)
    return await _marked(connection, passes) if retractions else passes


async def _marked(connection: AsyncConnection, passes: Sequence[StoredPass]) -> list[StoredPass]:
    out = await marks.mark(connection, (item.id for item in passes))
    return [item for item in passes if item.id not in out]


def _only(message: ResolvedMessage, *, plain: bool) -> ResolvedMessage:
    """Return a message with those of its passes that are plainly about a map feature, or with the others."""
    return replace(message, passes=tuple(item for item in message.passes if item.plain is plain))


async def _match(
    connection: AsyncConnection, messages: Sequence[ResolvedMessage], policy: Policy
) -> list[ResolvedMessage]:
    """Tie passes that name nothing to the map features they must be about."""
    unreferenced = [
        (number, index, (item.map_id, *item.place[:2]))
        for number, message in enumerate(messages)
        for index, item in enumerate(message.passes)
        if item.place and item.feature_id is None and item.watch_id is None
    ]
    nearby = await reads.features_near(connection, [place for *_, place in unreferenced], reads.degrees(policy.reach_m))
    passes = [list(message.passes) for message in messages]
    for (number, index, _), near in zip(unreferenced, nearby, strict=True):
        feature = match_feature(passes[number][index], messages[number].map_sequence, near, policy)
        if feature is not None:
            passes[number][index] = replace(passes[number][index], feature_id=feature.id)
    return [replace(message, passes=tuple(mine)) for message, mine in zip(messages, passes, strict=True)]


def _candidates(passes: Iterable[StoredPass], known: Lookups) -> tuple[Places, frozenset[int]]:
    """Return the places of finds, near which candidates may change, and the candidates that were watched."""
    places, watched = set[tuple[int, float, float]](), set[int]()
    for item in passes:
        if item.clusters and item.place:
            places.add((item.map_id, *item.place[:2]))
        elif item.watch_id is not None and item.feature_id is None:
            watched.add(known.watches[item.watch_id].candidate_id)
    return frozenset(places), frozenset(watched)


def _decode(claimed: Iterable[ClaimedMessage]) -> tuple[dict[int, ReportMessage], dict[int, str]]:
    reports: dict[int, ReportMessage] = {}
    reasons: dict[int, str] = {}
    for message in claimed:
        try:
            reports[message.id] = decode_message(message.body)
        except SlamcuError as error:
            reasons[message.id] = str(error)
    return reports, reasons


def _resolve(
    claimed: Iterable[ClaimedMessage], reports: Mapping[int, ReportMessage], known: Lookups
) -> tuple[list[ResolvedMessage], dict[int, str]]:
    resolved: list[ResolvedMessage] = []
    reasons: dict[int, str] = {}
    for message in claimed:
        if message.id not in reports:
            continue
        try:
            resolved.append(resolve_message(message, reports[message.id], known))
        except SlamcuError as error:
            reasons[message.id] = str(error)
    return resolved, reasons
