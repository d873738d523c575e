"""Transactions of many small statements, which the driver executes itself.

SQLAlchemy takes 0.4 ms of processor for a statement and what it returns, the driver alone 0.15 (decision 0033). Who
folds asks some fifty a batch. Only statements that are written out (`statements.text`) go this way; transactions and
connections are SQLAlchemy's as ever. So are errors, DBAPIError with its SQLSTATE, but not the kinds of it that a
SQLSTATE stands for (IntegrityError and others). Results have no `rowcount`: ask for RETURNING.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import lru_cache
from typing import Any

import asyncpg
from sqlalchemy import Dialect, TextClause
from sqlalchemy.engine.result import IteratorResult, Result, SimpleResultMetaData
from sqlalchemy.exc import DBAPIError, InterfaceError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_server.database.statements import plan_once


@asynccontextmanager
async def begin(engine: AsyncEngine) -> AsyncIterator[AsyncConnection]:
    """Begin a transaction whose statements are planned once and executed by the driver itself."""
    async with engine.begin() as connection:
        await plan_once(connection)  # SQLAlchemy's first statement begins the transaction
        driver = (await connection.get_raw_connection()).driver_connection
        if driver is None:
            raise ConnectionError("the connection to work on is closed")
        yield _Direct(connection, driver)


class _Direct(AsyncConnection):
    """The connection of a transaction that has begun."""

    __slots__ = ("_driver",)

    def __init__(self, connection: AsyncConnection, driver: asyncpg.Connection[Any]) -> None:
        super().__init__(connection.engine, connection.sync_connection)
        self._driver = driver

    async def execute(self, statement: Any, parameters: Any = None, **options: Any) -> Result[Any]:  # type: ignore[override]  # no cursor
        """Execute a statement and return all of its rows."""
        if not isinstance(statement, TextClause) or options:
            executed: Result[Any] = await super().execute(statement, parameters, **options)
            return executed
        asked, names = _positional(statement, self.dialect)
        try:
            rows = await self._driver.fetch(asked, *[parameters[name] for name in names])
        except asyncio.CancelledError:
            # as SQLAlchemy does: nobody knows what the session has come to hold, such as a lock that no rollback frees
            await self.invalidate()
            raise
        except (asyncpg.PostgresError, asyncpg.InterfaceError) as error:
            lost = self._driver.is_closed()
            if lost:
                await self.invalidate(error)
            kind = InterfaceError if isinstance(error, asyncpg.InterfaceError) else DBAPIError
            raise kind(asked, None, error, hide_parameters=True, connection_invalidated=lost) from error
        columns = tuple(rows[0].keys()) if rows else ("none",)
        return IteratorResult(SimpleResultMetaData(columns), iter(rows))


@lru_cache(maxsize=512)
def _positional(statement: TextClause, dialect: Dialect) -> tuple[str, tuple[str, ...]]:
    """Return a statement as the driver takes it, and its parameters in order."""
    compiled = statement.compile(dialect=dialect)
    return compiled.string, tuple(compiled.positiontup or ())
