"""Tell the feed what has faded: beliefs that nobody has looked at for so long that they stand no longer.

When a belief fades is known as soon as it is folded (`fades_at`). The clock is the time of the newest report about the
map, not that of the wall: a recorded year that is played again tells what it told, and a fleet that stands still in its
garages withdraws nothing.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from datetime import timedelta
from typing import Any

from sqlalchemy import Row
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import aside, reads
from slamcu_server.aggregation.aside import Work, due
from slamcu_server.aggregation.attempts import BatchError, attempt
from slamcu_server.aggregation.cells import Cell
from slamcu_server.aggregation.locks import BeyondLockedCells, lock_cells
from slamcu_server.aggregation.refold import Touched, cells_of, refold
from slamcu_server.changes import feed
from slamcu_server.database.statements import text
from slamcu_server.retraction import marks
from slamcu_server.trust.table import trusting

logger = logging.getLogger(__name__)

_Row = Row[tuple[Any, ...]]
_AT_ONCE = 50  # changes that one transaction looks at

_OPEN = """
    FROM changes c LEFT JOIN feature_states s ON s.feature_id = c.feature_id
    LEFT JOIN candidates k ON k.id = c.candidate_id AND k.merged_into IS NULL
    WHERE c.state IN ('candidate', 'confirmed') AND"""
_ANY_SOON = text(f"SELECT EXISTS (SELECT {_OPEN} LEAST(s.fades_at, k.fades_at) <= now() + :ahead)")
_DUE = text(f"""
    SELECT c.id, c.feature_id, c.candidate_id, c.map_id, ST_X(p.geom) AS lon, ST_Y(p.geom) AS lat
    {_OPEN.replace("WHERE", "LEFT JOIN passes p ON p.id = k.founding_pass JOIN maps m ON m.id = c.map_id WHERE")}
        LEAST(s.fades_at, k.fades_at) <= m.evidence_time AND c.id > :after AND {due(Work.FADING, "c.id")}
    ORDER BY c.id LIMIT :limit""")
_SET_CLOCKS = text("""
    UPDATE maps m SET evidence_time = newest.at FROM (
        SELECT map_id, max(at) AS at FROM (
            SELECT f.map_id, max(s.last_looked) AS at FROM feature_states s JOIN features f ON f.id = s.feature_id
            GROUP BY f.map_id
            UNION ALL SELECT map_id, max(last_looked) FROM candidates GROUP BY map_id) either
        GROUP BY map_id) newest
    WHERE newest.map_id = m.id AND newest.at > COALESCE(m.evidence_time, '-infinity')""")


async def fade(engine: AsyncEngine, policy: Policy, *, clock_ahead: timedelta = timedelta(days=1)) -> int:
    """Withdraw or revise what has faded, and return how many entries the feed got.

    Parameters
    ----------
    clock_ahead : how far in the future reports may lie.
    """
    async with engine.begin() as connection:
        begun = (await connection.execute(text("SELECT now()"))).scalar_one()
        soon = (await connection.execute(_ANY_SOON, {"ahead": clock_ahead})).scalar_one()
        if soon:
            await connection.execute(_SET_CLOCKS)
    told, after = 0, 0
    while soon:
        async with engine.connect() as connection:
            due_now = list(await connection.execute(_DUE, {"after": after, "limit": _AT_ONCE}))
        if not due_now:
            break
        told += await _look_again(engine, policy, due_now)
        after = due_now[-1].id
    async with engine.begin() as connection:
        await aside.drop_due(connection, Work.FADING, begun)  # what had failed, and was done now or need not be
    return told


async def _look_again(engine: AsyncEngine, policy: Policy, rows: Sequence[_Row]) -> int:
    """Tell of a piece what has faded; of one that fails for a reason that does not pass, change by change.

    Those that fail by themselves are put aside. They are tried again later, and nothing else waits for them.
    """
    try:
        return await attempt(lambda: _piece(engine, policy, rows))
    except BatchError as failed:
        if len(rows) > 1:
            logger.warning("a piece of %d changes failed and is tried one by one", len(rows), exc_info=failed)
            return sum([await _look_again(engine, policy, [row]) for row in rows])
        logger.exception("the fading of change %d is put aside", rows[0].id)
        async with engine.begin() as connection:
            await aside.put(connection, Work.FADING, rows[0].id, failed.reason)
        return 0


async def _piece(engine: AsyncEngine, policy: Policy, rows: Sequence[_Row]) -> int:
    features = frozenset(row.feature_id for row in rows if row.feature_id is not None)
    places = frozenset((row.map_id, row.lon, row.lat) for row in rows if row.lon is not None)
    further: frozenset[Cell] = frozenset()
    while True:
        try:
            async with engine.begin() as connection:
                return await _publish(connection, Touched(features, places), policy, further)
        except BeyondLockedCells as beyond:
            further |= beyond.cells
        except Exception as error:
            raise BatchError("changes", [row.id for row in rows]) from error


async def _publish(connection: AsyncConnection, touched: Touched, policy: Policy, further: frozenset[Cell]) -> int:
    await marks.hold(connection)
    policy = await trusting(connection, policy)
    anchors = await reads.anchors(connection, touched.features or ())
    held = further | cells_of([*anchors, *(touched.places or ())], policy)
    await lock_cells(connection, held)
    entries = await feed.publish(connection, await refold(connection, touched, held, policy), policy)
    await feed.append(connection, entries)
    return len(entries)
