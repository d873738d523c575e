"""How far the aggregation is behind."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.database.tables import messages


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
