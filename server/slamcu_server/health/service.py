"""What the server needs in order to serve."""

from __future__ import annotations

import asyncio
import logging

import asyncpg
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_server.database import migrate
from slamcu_server.logs import told
from slamcu_server.runtime import WorkerSupervisor

logger = logging.getLogger(__name__)

_TIMEOUT_S = 5.0


async def failing(engine: AsyncEngine, worker: WorkerSupervisor | None) -> list[str]:
    """Return what keeps the server from serving, in words; nothing if it can."""
    reasons = []
    try:
        async with asyncio.timeout(_TIMEOUT_S), engine.connect() as connection:
            revision = await migrate.current(connection)
        # A newer schema serves this code too: migrations take nothing away that older servers need, which run beside.
        if revision is None or (revision != migrate.head() and migrate.known(revision)):
            reasons.append(f"the database's schema is at {revision or 'nothing'}, not at {migrate.head()}")
    except (SQLAlchemyError, asyncpg.PostgresError, OSError, TimeoutError) as error:
        logger.warning("the database is not reachable: %s", told(error))
        reasons.append("the database is not reachable")
    if worker is not None and not worker.healthy:
        reasons.append("the aggregation worker of this process does not run")
    return reasons
