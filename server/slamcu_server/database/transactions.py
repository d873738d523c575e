"""The transactions that a request works in."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Annotated, Any
from weakref import WeakKeyDictionary

from fastapi import Depends, Request
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

_PATIENCE_S = 3
_LOCK_TIMEOUT = text(f"SET LOCAL lock_timeout = '{_PATIENCE_S}s'")
_STATEMENT_TIMEOUT = text("SET LOCAL statement_timeout = '30s'")

_SHARE = 3
"""One connection of so many may be had by transactions that wait for locks: reads and reports go on beside them."""

_deciding: WeakKeyDictionary[Any, asyncio.Semaphore] = WeakKeyDictionary()
"""The connections that are left for such transactions, by pool."""


def get_engine(request: Request) -> AsyncEngine:
    """Return the engine of the application that serves `request`."""
    engine: AsyncEngine = request.app.state.engine
    return engine


async def read_transaction(engine: Annotated[AsyncEngine, Depends(get_engine)]) -> AsyncIterator[AsyncConnection]:
    """Give a request one read-only snapshot of the database."""
    async with engine.connect() as connection:
        await connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
        async with connection.begin():
            # of requests only: imports, workers and migrations take their time
            await connection.execute(_STATEMENT_TIMEOUT)
            yield connection


async def write_transaction(engine: Annotated[AsyncEngine, Depends(get_engine)]) -> AsyncIterator[AsyncConnection]:
    """Give a request one transaction, committed before its response is sent and rolled back if it fails."""
    async with engine.begin() as connection:
        yield connection


@asynccontextmanager
async def deciding(engine: AsyncEngine) -> AsyncIterator[AsyncConnection]:
    """Begin a transaction that gives up, as busy, where it would wait long for a lock of an import or a worker.

    Few of a pool's connections are for such transactions. Raises TimeoutError where that would have to be waited for as
    long as for a lock.
    """
    turns = _deciding.setdefault(engine.sync_engine, asyncio.Semaphore(max(1, engine.pool.size() // _SHARE)))  # type: ignore[attr-defined]  # of a pool that queues
    try:
        async with asyncio.timeout(_PATIENCE_S):
            await turns.acquire()
    except TimeoutError:
        raise TimeoutError("other decisions wait for locks") from None
    try:
        async with engine.begin() as connection:
            await connection.execute(_LOCK_TIMEOUT)
            await connection.execute(_STATEMENT_TIMEOUT)
            yield connection
    finally:
        turns.release()


async def decision_transaction(engine: Annotated[AsyncEngine, Depends(get_engine)]) -> AsyncIterator[AsyncConnection]:
    """Give a request a transaction (`deciding`), committed before its response is sent and rolled back if it fails."""
    async with deciding(engine) as connection:
        yield connection


# scope="function": the commit comes before the answer, so that what is acknowledged is durable.
ReadTransaction = Annotated[AsyncConnection, Depends(read_transaction, scope="function")]
WriteTransaction = Annotated[AsyncConnection, Depends(write_transaction, scope="function")]
DecisionTransaction = Annotated[AsyncConnection, Depends(decision_transaction, scope="function")]
EngineDependency = Annotated[AsyncEngine, Depends(get_engine)]
