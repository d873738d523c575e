"""Worker processes of the server on the bench's database: started, called, watched from outside, stopped."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from time import perf_counter
from typing import Any

import asyncpg

from slamcu_core.errors import SlamcuError

_COMMAND = (sys.executable, "-m", "slamcu_server", "worker")
_READY_S, _STOP_S, _LOOK_S = 60.0, 20.0, 0.02
_LISTENING = "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND query LIKE 'LISTEN%'"
_WAITING = "SELECT count(*) FROM messages WHERE state = 'pending'"
_PUT_ASIDE = "SELECT count(*), max(error) FROM messages WHERE state = 'quarantined'"


@asynccontextmanager
async def working(database_url: str, count: int, connection: asyncpg.Connection[Any]) -> AsyncIterator[list[int]]:
    """Run a number of workers, all listening when this is entered, and give their process ids.

    Raises SlamcuError if one does not start.
    """
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SLAMCU_")}
    environment |= {"SLAMCU_DATABASE_URL": database_url, "SLAMCU_LOG_LEVEL": "warning"}
    environment |= {"SLAMCU_PASSES_PER_S": "0"}  # a few vehicles stand for many
    processes = [
        subprocess.Popen(  # noqa: S603, ASYNC220  (our own program; nothing else runs meanwhile)
            _COMMAND, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=None
        )
        for _ in range(count)
    ]
    try:
        deadline = perf_counter() + _READY_S
        while await connection.fetchval(_LISTENING) < count:
            if perf_counter() > deadline or any(process.poll() is not None for process in processes):
                raise SlamcuError("a worker did not start")
            await asyncio.sleep(_LOOK_S)
        yield [process.pid for process in processes]
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


async def backends(connection: asyncpg.Connection[Any], application: str = "slamcu-worker") -> list[int]:
    """Return the process ids of PostgreSQL that serve an application, the workers unless another is named."""
    query = "SELECT pid FROM pg_stat_activity WHERE datname = current_database() AND application_name = $1"
    return [row["pid"] for row in await connection.fetch(query, application)]


async def until_fused(connection: asyncpg.Connection[Any], *, patience_s: float = 600.0) -> None:
    """Wait until nothing waits in the log. Raises SlamcuError if a message was put aside, or it takes too long."""
    deadline = perf_counter() + patience_s
    while await connection.fetchval(_WAITING):
        if perf_counter() > deadline:
            raise SlamcuError(f"the log was not fused within {patience_s:g} s")
        await asyncio.sleep(_LOOK_S)
    aside, why = await connection.fetchrow(_PUT_ASIDE)
    if aside:
        raise SlamcuError(f"{aside} messages were put aside: {why}")
