"""Tell the feed what has faded: beliefs that nobody has looked at for so long that they stand no longer.

When a belief fades is known as soon as it is folded (`fades_at`). The clock is the time of the newest report about the
map, not that of the wall: a recorded year that is played again tells what it told, and a fleet that stands still in its
garages withdraws nothing.
"""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import Row
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import reads
from slamcu_server.aggregation.cells import Cell
from slamcu_server.aggregation.locks import BeyondLockedCells, lock_cells
from slamcu_server.aggregation.refold import Touched, cells_of, refold
from slamcu_server.changes import feed
from slamcu_server.database.statements import text
from slamcu_server.retraction import marks
from slamcu_server.trust.table import trusting

_AT_ONCE = 50  # changes that one transaction looks at

_OPEN = """
    FROM changes c LEFT JOIN feature_states s ON s.feature_id = c.feature_id
    LEFT JOIN candidates k ON k.id = c.candidate_id AND k.merged_into IS NULL
    WHERE c.state IN ('candidate', 'confirmed') AND"""
_ANY_SOON = text(f"SELECT EXISTS (SELECT {_OPEN} LEAST(s.fades_at, k.fades_at) <= now() + :ahead)")
_DUE = text(f"""
    SELECT c.id, c.feature_id, c.candidate_id, c.map_id, ST_X(p.geom) AS lon, ST_Y(p.geom) AS lat
    {_OPEN.replace("WHERE", "LEFT JOIN passes p ON p.id = k.founding_pass JOIN maps m ON m.id = c.map_id WHERE")}
        LEAST(s.fades_at, k.fades_at) <= m.evidence_time AND c.id > :after
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
        if not (await connection.execute(_ANY_SOON, {"ahead": clock_ahead})).scalar_one():
            return 0
        await connection.execute(_SET_CLOCKS)
    told, after = 0, 0
    while True:
        async with engine.connect() as connection:
            due = list(await connection.execute(_DUE, {"after": after, "limit": _AT_ONCE}))
        if not due:
            return told
        told += await _look_again(engine, policy, due)
        after = due[-1].id


async def _look_again(engine: AsyncEngine, policy: Policy, due: list[Row[tuple[object, ...]]]) -> int:
    features = frozenset(row.feature_id for row in due if row.feature_id is not None)
    places = frozenset((row.map_id, row.lon, row.lat) for row in due if row.lon is not None)
    further: frozenset[Cell] = frozenset()
    while True:
        try:
            async with engine.begin() as connection:
                return await _publish(connection, Touched(features, places), policy, further)
        except BeyondLockedCells as beyond:
            further |= beyond.cells


async def _publish(connection: AsyncConnection, touched: Touched, policy: Policy, further: frozenset[Cell]) -> int:
    await marks.hold(connection)
    policy = await trusting(connection, policy)
    anchors = await reads.anchors(connection, touched.features or ())
    held = further | cells_of([*anchors, *(touched.places or ())], policy)
    await lock_cells(connection, held)
    entries = await feed.publish(connection, await refold(connection, touched, held, policy), policy)
    await feed.append(connection, entries)
    return len(entries)
