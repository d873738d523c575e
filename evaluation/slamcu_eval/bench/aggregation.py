"""Passes a second from the message log into the map's state, by one worker in batches as it takes them."""

from __future__ import annotations

import asyncio
from time import perf_counter
from typing import Any

from slamcu_core.aggregation import Policy
from slamcu_core.errors import SlamcuError
from slamcu_eval.bench.rounds import Rates
from slamcu_eval.bench.server import BenchServer
from slamcu_eval.bench.traffic import PASSES
from slamcu_server.aggregation.worker import BATCH_SIZE, fuse_pending
from slamcu_server.database.engine import create_engine


def bench_aggregation(server: BenchServer, batches: int) -> dict[str, Any]:
    """Fuse batches of what waits in the server's log, and return the rate in passes per second."""
    rates = Rates(tuple(asyncio.run(_fuse(server, batches))))
    return {"passes_per_s": rates.figures(), "messages_per_batch": BATCH_SIZE, "passes_per_message": PASSES}


async def _fuse(server: BenchServer, batches: int) -> list[float]:
    engine = create_engine(server.database_url, application_name="slamcu-bench")
    rates = []
    try:
        for number in range(batches + 1):
            begin = perf_counter()
            done = await fuse_pending(engine, Policy(), BATCH_SIZE)
            elapsed = perf_counter() - begin
            if done.quarantined or done.fused != BATCH_SIZE:
                raise SlamcuError(f"a batch of {BATCH_SIZE} was not fused whole: {done}")
            if number:  # the first one also opens connections and fills caches
                rates.append(done.fused * PASSES / elapsed)
    finally:
        await engine.dispose()
    return rates
