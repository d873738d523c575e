"""Apply what was decided about passes that are stored: mark them anew, and fold again what they are about.

A retraction is a record first. The worker then lists the passes concerned, and takes the list in pieces, each one
transaction: marks, beliefs, changes and their feed move together, and what is done leaves the list. Killed at any
moment, it goes on where it was; between two pieces every belief is the fold of the passes that count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sqlalchemy import Row, text
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import reads
from slamcu_server.aggregation.cells import Cell
from slamcu_server.aggregation.locks import BeyondLockedCells, lock_cells, require_cells
from slamcu_server.aggregation.refold import Touched, cells_of, refold
from slamcu_server.changes import feed
from slamcu_server.retraction import anchors, marks, repository, returning
from slamcu_server.retraction.repository import State, StoredRetraction
from slamcu_server.trust.table import trusting

PIECE = 200
"""Passes that one transaction takes: they stay far below the budget of cells that one may lock."""


@dataclass(frozen=True, slots=True)
class _Listed:
    """A piece of the list: which passes, and what they are about."""

    ids: tuple[int, ...]
    passes: frozenset[int]
    features: frozenset[int]
    places: frozenset[tuple[int, float, float]]


async def correct(engine: AsyncEngine, policy: Policy, piece: int = PIECE) -> bool:
    """Do the next piece of what there is to correct; return whether there was anything that nobody else does."""
    async with engine.connect() as connection:
        if not await repository.anything_to_correct(connection):
            return False
    async with engine.begin() as connection:
        waiting = await repository.claim(connection, (State.REQUESTED, State.UNDO_REQUESTED))
        if waiting is not None:
            await _list(connection, waiting)
            return True
    further: frozenset[Cell] = frozenset()
    while True:
        try:
            async with engine.begin() as connection:
                if await _correct_piece(connection, policy, piece, further):
                    return True
            break
        except BeyondLockedCells as beyond:
            further |= beyond.cells  # another try that holds these too, from the start, so that keys stay in order
    async with engine.begin() as connection:
        return await repository.finish(connection) > 0


async def correct_all(engine: AsyncEngine, policy: Policy, piece: int = PIECE) -> None:
    """Correct until nothing is left that nobody else does."""
    while await correct(engine, policy, piece):
        pass


async def _list(connection: AsyncConnection, waiting: StoredRetraction) -> None:
    if waiting.state is State.REQUESTED:
        await repository.list_passes(connection, waiting)
    else:
        await repository.list_marked(connection, waiting)


async def _correct_piece(connection: AsyncConnection, policy: Policy, piece: int, further: frozenset[Cell]) -> bool:
    await marks.hold(connection)
    policy = await trusting(connection, policy)
    listed = await _claim_piece(connection, piece)
    if not listed.ids:
        return False
    held = further | cells_of([*await reads.anchors(connection, listed.features), *listed.places], policy)
    await lock_cells(connection, held)
    # Another batch may have moved a watch report to the map feature that its candidate became while we waited.
    again = await _about(connection, listed.ids)
    require_cells(cells_of([*await reads.anchors(connection, again.features), *again.places], policy), held)
    turned = await marks.mark(connection, again.passes)
    tied = await returning.tie(connection, turned, policy)
    require_cells(cells_of(await reads.anchors(connection, tied), policy), held)
    passed_on = await anchors.pass_on(connection, again.passes)
    require_cells(cells_of(passed_on.places, policy), held)
    beliefs = await refold(connection, Touched(again.features | tied, again.places | passed_on.places), held, policy)
    beliefs = replace(beliefs, dissolved=passed_on.dissolved, corrected=True)
    entries = await feed.publish(connection, beliefs, policy)
    await connection.execute(
        text("DELETE FROM corrections WHERE id = ANY(CAST(:ids AS bigint[]))"), {"ids": list(listed.ids)}
    )
    await feed.append(connection, entries)
    return True


async def _claim_piece(connection: AsyncConnection, limit: int) -> _Listed:
    claimed = await connection.execute(
        text("SELECT id FROM corrections ORDER BY id LIMIT :limit FOR UPDATE SKIP LOCKED"), {"limit": limit}
    )
    return await _about(connection, [row.id for row in claimed])


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
        ids=tuple(ids),
        passes=frozenset(row.id for row in rows),
        features=frozenset(row.feature_id for row in rows if row.feature_id is not None and not row.archived),
        places=frozenset(place for row in rows if (place := _place(row)) is not None),
    )


def _place(row: Row[tuple[object, ...]]) -> tuple[int, float, float] | None:
    if row.archived or row.feature_id is not None:
        return None
    lon, lat = (row.lon, row.lat) if row.watch_lon is None else (row.watch_lon, row.watch_lat)
    return None if lon is None else (row.map_id, lon, lat)
