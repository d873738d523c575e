"""Apply what was decided about passes that are stored: mark them anew, and fold again what they are about.

A retraction is a record first. The worker then lists the passes concerned, and takes the list in pieces, each one
transaction: marks, beliefs, changes and their feed move together, and what is done leaves the list. Killed at any
moment, it goes on where it was; between two pieces every belief is the fold of the passes that count.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

from sqlalchemy import Row, text
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import aside, reads
from slamcu_server.aggregation.aside import Work
from slamcu_server.aggregation.attempts import BatchError, attempt, reason, transient
from slamcu_server.aggregation.cells import Cell
from slamcu_server.aggregation.locks import BeyondLockedCells, lock_cells, require_cells
from slamcu_server.aggregation.refold import Places, Touched, cells_of, refold
from slamcu_server.changes import feed
from slamcu_server.retraction import anchors, marks, repository, returning
from slamcu_server.retraction.repository import State, StoredRetraction
from slamcu_server.trust.table import trusting

logger = logging.getLogger(__name__)

PIECE = 200
"""Passes that one transaction takes: they stay far below the budget of cells that one may lock."""


@dataclass(frozen=True, slots=True)
class _Listed:
    """A piece of the list: which passes, and what they are about."""

    passes: frozenset[int]
    features: frozenset[int]
    places: Places


async def correct(engine: AsyncEngine, policy: Policy, piece: int = PIECE) -> bool:
    """Do the next piece of what there is to correct; return whether there was anything that nobody else does.

    A piece that fails for a reason that does not pass is tried pass by pass, and those that fail by themselves are put
    aside: they are tried again later, each alone, and nothing else waits for them.
    """
    async with engine.connect() as connection:
        if not await repository.anything_to_correct(connection):
            return False
    if await _list_next(engine):
        return True
    try:
        if await attempt(lambda: _piece(engine, policy, piece)):
            return True
    except BatchError as failed:
        logger.warning("a piece of %d corrections failed and is tried one by one", len(failed.ids), exc_info=failed)
        for key in failed.ids:
            await _correct_alone(engine, policy, key)
        return True
    async with engine.begin() as connection:
        return await repository.finish(connection) > 0


async def correct_all(engine: AsyncEngine, policy: Policy, piece: int = PIECE) -> None:
    """Correct until nothing is left that nobody else does."""
    while await correct(engine, policy, piece):
        pass


async def _list_next(engine: AsyncEngine) -> bool:
    """List the passes of the next retraction that is to be applied or undone; return whether there was one."""
    waiting: StoredRetraction | None = None
    try:
        async with engine.begin() as connection:
            waiting = await repository.claim(connection, (State.REQUESTED, State.UNDO_REQUESTED))
            if waiting is None:
                return False
            if waiting.state is State.REQUESTED:
                await repository.list_passes(connection, waiting)
            else:
                await repository.list_marked(connection, waiting)
            await aside.done(connection, Work.RETRACTION, [waiting.id])
    except Exception as error:
        if waiting is None or transient(error):
            raise
        logger.exception("the listing of retraction %d is put aside", waiting.id)
        async with engine.begin() as connection:
            await aside.put(connection, Work.RETRACTION, waiting.id, reason(error))
    return True


async def _correct_alone(engine: AsyncEngine, policy: Policy, key: int) -> None:
    try:
        await attempt(lambda: _piece(engine, policy, 1, [key]))
    except BatchError as failed:
        async with engine.begin() as connection:
            for mine in await repository.claim_corrections(connection, 1, [key]):
                logger.exception("correction %d is put aside", mine)
                await aside.put(connection, Work.CORRECTION, mine, failed.reason)


async def _piece(engine: AsyncEngine, policy: Policy, limit: int, ids: Sequence[int] | None = None) -> bool:
    """Correct up to `limit` listed passes (of `ids`, if given); raise BatchError for whatever goes wrong."""
    further: frozenset[Cell] = frozenset()
    while True:
        claimed: list[int] = []
        try:
            async with engine.begin() as connection:
                await marks.hold(connection)
                claimed += await repository.claim_corrections(connection, limit, ids)
                if claimed:
                    await _correct_piece(connection, policy, claimed, further)
                return bool(claimed)
        except BeyondLockedCells as beyond:
            further |= beyond.cells  # another try that holds these too, from the start, so that keys stay in order
        except Exception as error:
            if not claimed:
                raise
            raise BatchError("corrections", claimed) from error


async def _correct_piece(
    connection: AsyncConnection, policy: Policy, ids: Sequence[int], further: frozenset[Cell]
) -> None:
    policy = await trusting(connection, policy)
    listed = await _about(connection, ids)
    held = further | cells_of([*await reads.anchors(connection, listed.features), *listed.places], policy)
    await lock_cells(connection, held)
    # Another batch may have moved a watch report to the map feature that its candidate became while we waited.
    again = await _about(connection, ids)
    require_cells(cells_of([*await reads.anchors(connection, again.features), *again.places], policy), held)
    turned = await marks.mark(connection, again.passes)
    tied = await returning.tie(connection, turned, policy)
    require_cells(cells_of(await reads.anchors(connection, tied), policy), held)
    passed_on = await anchors.pass_on(connection, again.passes)
    require_cells(cells_of(passed_on.places, policy), held)
    beliefs = await refold(connection, Touched(again.features | tied, again.places | passed_on.places), held, policy)
    beliefs = replace(beliefs, dissolved=passed_on.dissolved, corrected=True)
    entries = await feed.publish(connection, beliefs, policy)
    await repository.strike_off(connection, ids)
    await feed.append(connection, entries)


async def _about(connection: AsyncConnection, ids: Sequence[int]) -> _Listed:
    """Return what listed passes are about: map features, places of finds, and founding places of watch features."""
    found = await connection.execute(
        text("""
        SELECT p.id, p.map_id, p.feature_id, p.archived, ST_X(p.geom) AS lon, ST_Y(p.geom) AS lat,
               ST_X(f.geom) AS watch_lon, ST_Y(f.geom) AS watch_lat
        FROM corrections l JOIN passes p ON p.id = l.pass_id
        LEFT JOIN candidates c ON c.id = p.watch_id LEFT JOIN passes f ON f.id = c.founding_pass
        WHERE l.id = ANY(CAST(:ids AS bigint[]))"""),
        {"ids": list(ids)},
    )
    rows = list(found)
    return _Listed(
        passes=frozenset(row.id for row in rows),
        features=frozenset(row.feature_id for row in rows if row.feature_id is not None and not row.archived),
        places=frozenset(place for row in rows if (place := _place(row)) is not None),
    )


def _place(row: Row[tuple[object, ...]]) -> tuple[int, float, float] | None:
    if row.archived or row.feature_id is not None:
        return None
    lon, lat = (row.lon, row.lat) if row.watch_lon is None else (row.watch_lon, row.watch_lat)
    return None if lon is None else (row.map_id, lon, lat)
