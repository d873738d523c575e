"""Who runs the server: he sees its database, knows when all is fused, and recomputes trust when the hour has come.

One connection serves for all of it. What `slamcu-server recompute-trust` and `/metrics` would say is the same, but the
start of a process for each hour, and counting everything that can be counted at each look, took half of an experiment.
"""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from types import TracebackType
from typing import Self

from slamcu_core.aggregation import Policy
from slamcu_eval.fleet import Cloud, CloudError
from slamcu_server.metrics.repository import backlog
from slamcu_server.retraction.corrections import correct_all
from slamcu_server.runtime import open_database
from slamcu_server.settings import Settings
from slamcu_server.trust.job import recompute

_POLL_S = 0.02


class Operator:
    """Work on a running server's database, as a context manager."""

    def __init__(self, cloud: Cloud) -> None:
        self._cloud = cloud
        self._settings = Settings(database_url=None, data_dir=cloud.data_dir, migrate_on_start=False)
        self._runner = asyncio.Runner()
        self._stack = AsyncExitStack()

    def __enter__(self) -> Self:
        database = open_database(self._settings, application_name="slamcu-eval")
        try:
            self._engine = self._runner.run(self._stack.enter_async_context(database))
        except BaseException:
            self._runner.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._runner.run(self._stack.aclose())
        finally:
            self._runner.close()

    def recompute_trust(self) -> None:
        """Do what `slamcu-server recompute-trust` does, and fold again what that changes."""
        self._runner.run(self._recompute())

    def wait_until_fused(self, timeout_s: float) -> None:
        """Wait until everything that was acknowledged is fused; raise CloudError if it is not, or takes too long."""
        self._cloud.wait_until_fused(timeout_s, lambda: self._runner.run(self._pending()), _POLL_S)

    async def _recompute(self) -> None:
        await recompute(self._engine)
        await correct_all(self._engine, Policy())

    async def _pending(self) -> int:
        async with self._engine.connect() as connection:
            found = await backlog(connection)
        if found.quarantined:
            raise CloudError(f"{found.quarantined} messages could not be fused")
        return found.pending
