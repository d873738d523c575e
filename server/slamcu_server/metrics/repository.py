"""How far the aggregation is behind, how far the feed has come, and what has become of the changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, func, select, text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.database.tables import changes, feed_position, messages


@dataclass(frozen=True, slots=True)
class Backlog:
    """Messages that wait, messages that were put aside, and the times from a message to its effect."""

    pending: int
    quarantined: int
    lag_s: float  # age of the oldest that waits
    latency_s: float | None  # from acknowledged to fused: the median of the newest; None: none is known
    slow_latency_s: float | None  # likewise, the 95th percentile
    feed_sequence: int


async def backlog(connection: AsyncConnection) -> Backlog:
    """Count what is not aggregated yet (through the partial index of pending messages)."""
    pending = (
        select(func.count(), func.coalesce(func.extract("epoch", func.now() - func.min(messages.c.received_at)), 0.0))
        .select_from(messages)
        .where(messages.c.state == "pending")
    )
    count, lag = (await connection.execute(pending)).one()
    query = select(func.count()).select_from(messages).where(messages.c.state == "quarantined")
    quarantined = (await connection.execute(query)).scalar_one()
    # Through the index of fused messages that still have their bodies, so only of the newest.
    latency = text("""
        SELECT percentile_cont(ARRAY[0.5, 0.95]) WITHIN GROUP (ORDER BY seconds) FROM (
            SELECT extract(epoch FROM processed_at - received_at)::float8 AS seconds FROM messages
            WHERE state = 'fused' AND body IS NOT NULL ORDER BY processed_at DESC LIMIT 200) newest""")
    median, slow = (await connection.execute(latency)).scalar_one() or (None, None)
    sequence = (await connection.execute(select(feed_position.c.last_sequence))).scalar_one()
    return Backlog(count, quarantined, max(0.0, float(lag)), median, slow, sequence)


async def count_changes(connection: AsyncConnection) -> list[Row[Any]]:
    """Return (kind, state, count, mapped, seconds): how many changes, how many of them the map says, after how long."""
    columns = changes.c
    took = func.extract("epoch", columns.mapped_at - columns.first_evidence_at)
    query = select(
        columns.kind,
        columns.state,
        func.count().label("changes"),
        func.count(took).label("mapped"),
        func.coalesce(func.sum(took), 0.0).label("seconds"),
    ).group_by(columns.kind, columns.state)
    return list(await connection.execute(query))
