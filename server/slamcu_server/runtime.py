"""What every command works with: a database that is up and of the right schema, and a worker that is kept alive."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager

import asyncpg
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.errors import SlamcuError
from slamcu_server.database import migrate
from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.engine import create_engine
from slamcu_server.settings import Settings

logger = logging.getLogger(__name__)

_FIRST_RETRY_S, _LAST_RETRY_S = 0.5, 30.0


class DatabaseUnreachableError(SlamcuError):
    """The configured database does not answer."""


@asynccontextmanager
async def open_database(
    settings: Settings, *, application_name: str, check_schema: bool = True
) -> AsyncIterator[AsyncEngine]:
    """Open the database of `settings`: start the private cluster if it is ours, migrate or check the schema.

    Raises SlamcuError saying in one line what keeps the database from being used.
    """
    async with AsyncExitStack() as stack:
        url = settings.connection_url
        if url is None:
            cluster = EmbeddedCluster(settings.data_dir, bin_dir=settings.postgres_bin_dir)
            starting = asyncio.create_task(asyncio.to_thread(cluster.__enter__))
            stack.push_async_callback(_leave, cluster, starting)
            await asyncio.shield(starting)
            url = cluster.url
        engine = create_engine(url, application_name=application_name, pool_size=settings.database_pool_size)
        stack.push_async_callback(engine.dispose)
        if check_schema:
            try:
                if settings.migrates_on_start:
                    await migrate.upgrade(engine)
                else:
                    await migrate.require_head(engine)
            except (SQLAlchemyError, asyncpg.PostgresError, OSError, TimeoutError) as error:
                reason = (str(getattr(error, "orig", error)) or type(error).__name__).splitlines()[0]
                raise DatabaseUnreachableError(f"the database is not reachable: {reason}") from error
        yield engine


async def _leave(cluster: EmbeddedCluster, starting: asyncio.Task[EmbeddedCluster]) -> None:
    """Leave the cluster, once it has started, if it could: a thread that starts it cannot be interrupted."""
    await asyncio.wait({starting})
    if starting.exception() is None:
        await asyncio.to_thread(cluster.__exit__, None, None, None)


class WorkerSupervisor:
    """Run a worker as a task of this process, and again after a failure."""

    def __init__(self, run: Callable[[asyncio.Event], Awaitable[None]]) -> None:
        self._run = run
        self._stop = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self._failed = False

    @property
    def healthy(self) -> bool:
        """Whether the worker runs and did not just fail."""
        return self._task is not None and not self._task.done() and not self._failed

    def start(self) -> None:
        """Start the worker."""
        self._task = asyncio.create_task(self._keep_running(), name="aggregation worker")

    async def stop(self, grace_s: float) -> None:
        """Ask the worker to stop, and cancel it if it takes longer than `grace_s`: its transaction rolls back."""
        if self._task is None:
            return
        self._stop.set()
        _, late = await asyncio.wait({self._task}, timeout=grace_s)
        if late:
            self._task.cancel()
            await asyncio.wait({self._task})

    async def _keep_running(self) -> None:
        wait_s = _FIRST_RETRY_S
        loop = asyncio.get_running_loop()
        while not self._stop.is_set():
            begun = loop.time()
            recovery = loop.call_later(wait_s, setattr, self, "_failed", False)
            try:
                await self._run(self._stop)
                if not self._stop.is_set():
                    raise RuntimeError("the worker ended without being asked to")  # noqa: TRY301
            except Exception:  # whatever it was, reports must go on being fused
                self._failed = True
                logger.exception("the aggregation worker failed and is started again in %.1f s", wait_s)
            finally:
                recovery.cancel()
            if loop.time() - begun > _LAST_RETRY_S:
                wait_s = _FIRST_RETRY_S
            try:
                await asyncio.wait_for(self._stop.wait(), wait_s)
            except TimeoutError:
                wait_s = min(2 * wait_s, _LAST_RETRY_S)
