"""How far the aggregation is behind, and what has become of the changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, func, select
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.database.tables import changes, messages


@dataclass(frozen=True, slots=True)
class Backlog:
    """Messages that wait, messages that were put aside, and the age of the oldest that waits."""

    pending: int
    quarantined: int
    lag_s: float


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
    return Backlog(count, quarantined, max(0.0, float(lag)))


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
