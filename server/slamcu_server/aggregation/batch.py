"""One batch: messages, their passes and all that follows from them, in one transaction.

Locks come before reads, and reads are new statements (READ COMMITTED), so a batch sees everything that those before it
wrote about its cells. The appending to the feed comes last, because all batches wait for each other there.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import log, quiet, reads, windows
from slamcu_server.aggregation.attempts import BatchError
from slamcu_server.aggregation.cells import Cell, regions_of
from slamcu_server.aggregation.condensed import read
from slamcu_server.aggregation.locks import (
    CELL_BUDGET,
    BeyondLockedCells,
    announce,
    lock_cells,
    require_cells,
    try_cells,
)
from slamcu_server.aggregation.log import ClaimedMessage
from slamcu_server.aggregation.lookups import Lookups, lookups, lookups_again
from slamcu_server.aggregation.matching import match
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.aggregation.refold import Places, Touched, cells_of, refold
from slamcu_server.aggregation.resolve import Resolved, passes_of, resolve, within_budget
from slamcu_server.aggregation.store import new_ids, store_passes
from slamcu_server.changes import feed
from slamcu_server.database import direct
from slamcu_server.retraction import anchors, marks
from slamcu_server.trust.table import trusting

Indices = NDArray[np.intp]

_PATIENCE = 0.25
"""How often a batch waits for the cells of its oldest message if another one holds them: no message is put off for
ever, and most batches wait for nothing."""

_LITTLE = 64
"""Messages: who took all there was, and not more than these, has time to wait, always: or its oldest would find another
one in its way time after time, while those that came later are seen."""


@dataclass(frozen=True, slots=True)
class Fused:
    """What one batch did."""

    fused: int = 0
    quarantined: int = 0

    @property
    def messages(self) -> int:
        """How many messages do not wait any more."""
        return self.fused + self.quarantined


async def process_batch(engine: AsyncEngine, policy: Policy, *, limit: int, ids: Sequence[int] | None = None) -> Fused:
    """Fuse up to `limit` pending messages (of `ids`, if given) and return what was done.

    Raises BatchError, with the messages it is about, for whatever went wrong after they were claimed.
    """
    awaited: frozenset[Cell] = frozenset()
    while True:
        claimed: list[ClaimedMessage] = []
        try:
            async with direct.begin(engine) as connection:
                retractions = await marks.hold(connection)
                if awaited:
                    await lock_cells(connection, awaited)
                most = limit if ids is not None else await log.share(connection, limit)
                claimed += await log.claim(connection, most, ids, beside_others=bool(awaited))
                if not claimed:
                    return Fused()
                patience = 1.0 if len(claimed) < most and len(claimed) <= _LITTLE else _PATIENCE
                return await _fuse(connection, claimed, policy, awaited, patience=patience, retractions=retractions)
        except BeyondLockedCells as beyond:
            # Another try, which waits for these before it holds any cell or message.
            awaited |= beyond.cells
        except Exception as error:
            if not claimed:
                raise
            raise BatchError("messages", [message.id for message in claimed]) from error


async def quarantine(engine: AsyncEngine, message_id: int, reason: str) -> None:
    """Put one message aside, if it is still pending and nobody else holds it."""
    async with engine.begin() as connection:
        claimed = await log.claim(connection, 1, [message_id])
        await log.quarantine(connection, {message.id: reason for message in claimed})


async def _fuse(
    connection: AsyncConnection,
    claimed: Sequence[ClaimedMessage],
    policy: Policy,
    awaited: frozenset[Cell],
    *,
    patience: float,
    retractions: bool,
) -> Fused:
    policy = await trusting(connection, policy)
    reported, reasons = await asyncio.to_thread(read, claimed)
    known = await lookups(connection, reported)
    resolved, unresolvable = resolve(reported, known)
    reasons |= unresolvable
    entries: list[feed.Entry] = []
    if resolved.messages:
        read_of = resolved.messages
        resolved, cells = await _hold(connection, resolved, awaited, policy, patience=patience)
        if resolved.messages < read_of:
            await log.call(connection)  # somebody without work may be free for these when this batch is done
        # What candidates are may have changed meanwhile: another batch can have merged them, a review accepted them.
        again = await lookups_again(connection, known)
        if again is not known:
            resolved = _looked_again(resolved, again, cells, policy)
        await log.mark_fused(connection, (message.id for message in resolved.reported.claimed))
        plain = await _store_plain(connection, resolved, retractions=retractions)
        resolved, stored, others = await _store_others(connection, resolved, cells, policy, retractions=retractions)
        added = np.concatenate([plain, stored])
        added = added[(resolved.feature_id[added] > 0) & ~resolved.archived[added]]
        records = windows.of_columns(resolved, added)
        loud = await quiet.append(connection, resolved.feature_id[added], records, again.features, policy)
        places, watched = _candidates(others, again)
        places |= await _revive(connection, others, again, cells, policy)
        beliefs = await refold(connection, Touched(loud, places, watched), cells, policy)
        entries = await feed.publish(connection, beliefs, policy)
    await log.quarantine(connection, reasons)
    await feed.append(connection, entries)
    return Fused(resolved.messages, len(reasons))


async def _hold(
    connection: AsyncConnection, resolved: Resolved, awaited: frozenset[Cell], policy: Policy, *, patience: float
) -> tuple[Resolved, frozenset[Cell]]:
    """Return the messages to fuse now, and their cells, which are held.

    Nothing is waited for: messages that another batch is in the way of stay in the log, for there is other work.
    Raises BeyondLockedCells, to wait for the oldest's, if there is not, and so often (`patience`) if the oldest is
    among them; or if one message takes more cells than the budget.
    """
    taken, cells = within_budget(resolved, policy.lock_reach_m, CELL_BUDGET, awaited)
    if len(cells) > CELL_BUDGET:
        if not cells <= awaited:
            raise BeyondLockedCells(cells)
        return taken, cells
    held = awaited | await try_cells(connection, cells - awaited)
    await announce(connection, regions_of(held))
    if held == cells:
        return taken, cells
    message, keys = taken.keys(policy.lock_reach_m)
    free = np.ones(taken.messages, bool)
    free[message[~np.isin(keys, [cell.key for cell in held])]] = False
    if not free.any() or (not free[0] and random.random() < patience):  # noqa: S311  (no secret)
        raise BeyondLockedCells(frozenset(map(Cell.of_key, np.unique(keys[message == 0]).tolist())))
    return taken.only(free), held


def _looked_again(resolved: Resolved, known: Lookups, held: frozenset[Cell], policy: Policy) -> Resolved:
    """Return what passes are about now that the cells are held. Raises BeyondLockedCells if it takes others."""
    now, reasons = resolve(resolved.reported, known)
    if reasons:
        raise BeyondLockedCells(frozenset())
    require_cells(frozenset(map(Cell.of_key, np.unique(now.keys(policy.lock_reach_m)[1]).tolist())), held)
    return now


async def _store_plain(connection: AsyncConnection, resolved: Resolved, *, retractions: bool) -> Indices:
    """Store the passes that name map features, and return those that no retraction takes out."""
    plain = np.flatnonzero(resolved.plain)
    if not retractions:
        await store_passes(connection, resolved, plain)
        return plain
    ids = await new_ids(connection, len(plain))
    await store_passes(connection, resolved, plain, ids)
    return plain[~np.isin(ids, sorted(await marks.mark(connection, ids.tolist())))]


async def _store_others(
    connection: AsyncConnection, resolved: Resolved, held: frozenset[Cell], policy: Policy, *, retractions: bool
) -> tuple[Resolved, Indices, list[StoredPass]]:
    """Store the other passes, with what they turn out to be about.

    Return that, and those that no retraction takes out, by their numbers and one by one.
    """
    chosen = np.flatnonzero(~resolved.plain)
    ids = await new_ids(connection, len(chosen))
    sequence = resolved.reported.of_messages(resolved.map_sequence, np.int64)[chosen].tolist()
    passes = await match(connection, passes_of(resolved, chosen, ids), sequence, policy)
    about = resolved.feature_id.copy()
    about[chosen] = [item.feature_id or 0 for item in passes]
    require_cells(cells_of(await reads.anchors(connection, set(about[chosen].tolist()) - {0}), policy), held)
    resolved = replace(resolved, feature_id=about)
    await store_passes(connection, resolved, chosen, ids)
    out = await marks.mark(connection, ids.tolist()) if retractions else frozenset()
    kept = [item for item in passes if item.id not in out]
    return resolved, chosen[~np.isin(ids, sorted(out))], kept


async def _revive(
    connection: AsyncConnection, passes: Iterable[StoredPass], known: Lookups, held: frozenset[Cell], policy: Policy
) -> Places:
    """Let reports about candidates that were dissolved found them anew, if they can, and return where they saw them."""
    watches = {item.id: known.watches[item.watch_id] for item in passes if item.watch_id is not None}
    naming = [key for key, watch in watches.items() if watch.dissolved and watch.feature_id is None]
    if not naming:
        return frozenset()
    places = (await anchors.pass_on(connection, naming)).places
    require_cells(cells_of(places, policy), held)
    return places


def _candidates(passes: Iterable[StoredPass], known: Lookups) -> tuple[Places, frozenset[int]]:
    """Return the places of finds, near which candidates may change, and the candidates that were watched."""
    places, watched = set[tuple[int, float, float]](), set[int]()
    for item in passes:
        if item.clusters and item.place:
            places.add((item.map_id, *item.place[:2]))
        elif item.watch_id is not None and item.feature_id is None:
            watched.add(known.watches[item.watch_id].candidate_id)
    return frozenset(places), frozenset(watched)
