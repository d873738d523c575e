"""The connection pool, and the transactions that a request works in."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import Depends, Request
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine, create_async_engine


def create_engine(url: str, *, application_name: str = "slamcu", pool_size: int = 10) -> AsyncEngine:
    """Create the pool of connections to `url` (postgresql+asyncpg).

    Behind PgBouncer add ``?prepared_statement_cache_size=0&statement_cache_size=0`` to the URL.
    """
    return create_async_engine(
        url,
        pool_size=pool_size,
        max_overflow=0,
        pool_pre_ping=True,  # the database may have been restarted since a connection was last used
        pool_timeout=10,
        connect_args={
            "timeout": 10,
            # jit costs more than it saves on short queries
            "server_settings": {"application_name": application_name, "jit": "off", "timezone": "UTC"},
        },
    )


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
