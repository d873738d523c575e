"""The transactions that a request works in."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import Depends, Request
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine


def get_engine(request: Request) -> AsyncEngine:
    """Return the engine of the application that serves `request`."""
    engine: AsyncEngine = request.app.state.engine
    return engine


async def read_transaction(engine: Annotated[AsyncEngine, Depends(get_engine)]) -> AsyncIterator[AsyncConnection]:
    """Give a request one read-only snapshot of the database."""
    async with engine.connect() as connection:
        await connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
        async with connection.begin():
            yield connection


async def write_transaction(engine: Annotated[AsyncEngine, Depends(get_engine)]) -> AsyncIterator[AsyncConnection]:
    """Give a request one transaction, committed before its response is sent and rolled back if it fails."""
    async with engine.begin() as connection:
        yield connection


# scope="function": the commit comes before the answer, so that what is acknowledged is durable.
ReadTransaction = Annotated[AsyncConnection, Depends(read_transaction, scope="function")]
WriteTransaction = Annotated[AsyncConnection, Depends(write_transaction, scope="function")]
EngineDependency = Annotated[AsyncEngine, Depends(get_engine)]
