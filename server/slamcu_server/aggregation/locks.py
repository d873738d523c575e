"""The locks under which evidence is folded, taken in one order by everybody."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation.cells import Cell, lock_keys, map_key
from slamcu_server.database.statements import text

_REGIONS = 1 << 30  # the key of region 0; those of maps and cells begin at 2³¹
_TURN = 4  # the key of the turn to claim
_TURN_LOOKS, _TURN_LOOK_S = 10, 0.02

CELL_BUDGET = 1000
"""Cells that one transaction locks one by one; PostgreSQL's table of locks holds 6,400 by default, for everybody."""


class BeyondLockedCells(Exception):  # noqa: N818  (not an error: the transaction starts over with more cells)
    """What is to be folded reaches into cells that this transaction does not hold."""

    def __init__(self, cells: frozenset[Cell]) -> None:
        super().__init__(f"{len(cells)} further cells are needed")
        self.cells = cells


async def lock_cells(connection: AsyncConnection, cells: frozenset[Cell]) -> None:
    """Hold the cells until the transaction ends: all keys in ascending order, maps before their cells.

    Whoever needs more cells than the budget holds their maps instead, against everybody.
    """
    whole = len(cells) > CELL_BUDGET
    maps = sorted({map_key(cell.map_id) for cell in cells})
    mode = "pg_advisory_xact_lock" if whole else "pg_advisory_xact_lock_shared"
    await connection.execute(text(f"SELECT {mode}(key) FROM unnest(CAST(:keys AS bigint[])) AS key"), {"keys": maps})  # noqa: S608
    if not whole:
        await connection.execute(
            text("SELECT pg_advisory_xact_lock(key) FROM unnest(CAST(:keys AS bigint[])) AS key"),
            {"keys": lock_keys(cells)},
        )


async def try_cells(connection: AsyncConnection, cells: frozenset[Cell]) -> frozenset[Cell]:
    """Hold those of the cells, at most as many as the budget, that nobody else holds, and return them.

    Who has tried waits for no cell after that, or two could wait for each other.
    """
    maps = sorted({map_key(cell.map_id) for cell in cells})
    await connection.execute(
        text("SELECT pg_advisory_xact_lock_shared(key) FROM unnest(CAST(:keys AS bigint[])) AS key"), {"keys": maps}
    )
    found = await connection.execute(
        text("SELECT key FROM unnest(CAST(:keys AS bigint[])) AS key WHERE pg_try_advisory_xact_lock(key)"),
        {"keys": lock_keys(cells)},
    )
    return frozenset(Cell.of_key(row.key) for row in found)


@asynccontextmanager
async def turn(connection: AsyncConnection) -> AsyncIterator[None]:
    """Let one worker after the other look where others are and announce where it is, if they are quick about it.

    A courtesy, by a lock of the connection, which the end of the transaction would keep too long: who does not get his
    turn within a fifth of a second goes ahead.
    """
    key = {"key": _TURN}
    for _ in range(_TURN_LOOKS):
        mine = bool((await connection.execute(text("SELECT pg_try_advisory_lock(:key)"), key)).scalar_one())
        if mine:
            break
        await asyncio.sleep(_TURN_LOOK_S)
    try:
        yield
    except BaseException:
        if mine:
            await connection.invalidate()  # a transaction that has failed cannot give the turn back
        raise
    if mine:
        await connection.execute(text("SELECT pg_advisory_unlock(:key)"), key)


async def announce(connection: AsyncConnection, regions: Iterable[int]) -> None:
    """Tell the others until the transaction ends in which regions (`cells.region_at`) it is at work.

    Nobody waits for that: it is told by shared locks before the cells are known, and cells are what is really held.
    """
    await connection.execute(
        text("SELECT pg_advisory_xact_lock_shared(key) FROM unnest(CAST(:keys AS bigint[])) AS key"),
        {"keys": sorted(_REGIONS + region for region in regions)},
    )


async def announced(connection: AsyncConnection) -> list[int]:
    """Return the regions in which others are at work."""
    found = await connection.execute(
        text("""
        SELECT DISTINCT objid::bigint - :first AS region FROM pg_locks
        WHERE locktype = 'advisory' AND objsubid = 1 AND classid = 0 AND objid::bigint >= :first
          AND pid <> pg_backend_pid()
          AND database = (SELECT oid FROM pg_database WHERE datname = current_database())"""),
        {"first": _REGIONS},
    )
    return [row.region for row in found]


async def lock_maps(connection: AsyncConnection) -> None:
    """Hold every map against everybody until the transaction ends."""
    await connection.execute(
        text("SELECT pg_advisory_xact_lock(key) FROM (SELECT id << 31 AS key FROM maps ORDER BY id) AS keys")
    )


def require_cells(needed: frozenset[Cell], held: frozenset[Cell] | None) -> None:
    """Raise BeyondLockedCells if cells are needed that are not held; None holds everything."""
    if held is not None and not needed <= held:
        raise BeyondLockedCells(needed - held)
