"""Messages a second through HTTP into the durable log, beside the bare insert of the same bytes into the same table.

Batches of large messages are what a car sends that was offline; a car with a network sends each of its small messages
by itself, which is measured too: there a request costs more than what it carries.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, replace
from itertools import count
from statistics import median
from time import perf_counter
from typing import Any, TypeVar

import asyncpg
import httpx
import numpy as np

from slamcu_core.errors import SlamcuError
from slamcu_core.sensoris import join_batch, serialize_message
from slamcu_eval.bench import processor
from slamcu_eval.bench.rounds import Rates, interleave
from slamcu_eval.bench.server import BenchServer
from slamcu_eval.bench.traffic import Traffic
from slamcu_eval.bench.workers import backends

T = TypeVar("T")

CONNECTIONS = 4  # requests, or inserts, under way at a time
BATCH = 25  # messages per request, and per insert
CAR_PASSES = 3  # of the message that a car on the road sends by itself, some four times a minute

_INSERT = """
INSERT INTO messages (account_id, session_id, message_id, sha256, body)
SELECT $1, new.* FROM unnest($2::text[], $3::bigint[], $4::bytea[], $5::bytea[]) AS new
ON CONFLICT (account_id, session_id, message_id) DO NOTHING"""


@dataclass(frozen=True, slots=True)
class _Batch:
    """What one request carries."""

    vehicle: int
    session: str
    messages: tuple[bytes, ...]


class IngestBench:
    """Both ways of bringing the same messages into the log of one server."""

    def __init__(self, server: BenchServer, requests: int, seed: int) -> None:
        self._server, self._requests = server, requests
        self._rng = np.random.default_rng(seed)
        self._drives = count()
        self._traffic = Traffic(server.features, {})
        self.message_bytes = self.passes_per_message = 0.0
        self._used: list[tuple[float, float]] = []  # s of processor by the API and by the database, one by one

    def through_http(self) -> float:
        """Post one round of batches and return messages per second."""
        return asyncio.run(self._post(self._round()))

    def one_by_one(self) -> float:
        """Post one round of small messages, each in a request of its own, and return messages per second."""
        return asyncio.run(self._post_measured(self._small_round()))

    def processor_ms(self) -> dict[str, float]:
        """Return the processor time of a request with one small message in ms, by who used it: medians over rounds."""
        api, database = zip(*self._used, strict=True)
        return {name: 1e3 * median(each) / self._requests for name, each in (("api", api), ("database", database))}

    def bare_insert(self) -> float:
        """Insert one round of batches, a transaction each, and return messages per second."""
        return asyncio.run(self._insert(self._round()))

    def _round(self) -> list[_Batch]:
        """Make the batches of one round before its clock starts; every round has drives of its own."""
        drive = next(self._drives)
        batches = []
        for number in range(self._requests):
            vehicle = number % len(self._server.keys)
            session = drive * self._requests + number
            reports = list(self._traffic.messages(vehicle, session, BATCH, self._rng))
            self.passes_per_message = sum(len(one.passes) for one in reports) / BATCH
            batches.append(_Batch(vehicle, f"drive-{session}", tuple(map(serialize_message, reports))))
        self.message_bytes = sum(map(len, batches[-1].messages)) / BATCH
        return batches

    def _small_round(self) -> list[_Batch]:
        drive = next(self._drives)
        batches = []
        for number in range(self._requests):
            vehicle, session = number % len(self._server.keys), drive * self._requests + number
            (report,) = self._traffic.messages(vehicle, session, 1, self._rng)
            small = serialize_message(replace(report, passes=report.passes[:CAR_PASSES]))
            batches.append(_Batch(vehicle, f"drive-{session}", (small,)))
        return batches

    async def _post_measured(self, batches: list[_Batch]) -> float:
        connection = await asyncpg.connect(self._server.database_url.replace("+asyncpg", ""))
        try:
            served = set(await backends(connection, "slamcu-server"))
            before = processor.seconds([self._server.pid]), processor.seconds(served)
            rate = await self._post(batches)
            served.update(await backends(connection, "slamcu-server"))
            after = processor.seconds([self._server.pid]), processor.seconds(served)
        finally:
            await connection.close()
        self._used.append((after[0] - before[0], after[1] - before[1]))
        return rate

    async def _post(self, batches: list[_Batch]) -> float:
        limits = httpx.Limits(max_connections=CONNECTIONS)
        async with httpx.AsyncClient(base_url=self._server.url, limits=limits, timeout=60.0) as client:
            bodies = [(batch, join_batch(batch.messages)) for batch in batches]

            async def post(item: tuple[_Batch, bytes]) -> None:
                batch, body = item
                headers = {
                    "Authorization": f"Bearer {self._server.keys[batch.vehicle]}",
                    "Content-Type": "application/x-protobuf",
                }
                answer = await client.post("/v1/data-messages", content=body, headers=headers)
                if answer.status_code != 202 or answer.json()["accepted"] != len(batch.messages):
                    raise SlamcuError(f"the server did not take a batch: {answer.status_code} {answer.text[:300]}")

            return len(batches[0].messages) * await self._rate(post, bodies)

    async def _insert(self, batches: list[_Batch]) -> float:
        url = self._server.database_url.replace("+asyncpg", "")
        async with asyncpg.create_pool(url, min_size=CONNECTIONS, max_size=CONNECTIONS) as pool:
            accounts = [row["id"] for row in await pool.fetch("SELECT id FROM accounts ORDER BY id")]

            async def insert(batch: _Batch) -> None:
                hashes = [hashlib.sha256(message).digest() for message in batch.messages]
                numbers = list(range(1, len(batch.messages) + 1))
                sessions = [batch.session] * len(batch.messages)
                await pool.execute(_INSERT, accounts[batch.vehicle], sessions, numbers, hashes, batch.messages)

            return BATCH * await self._rate(insert, batches)

    async def _rate(self, work: Callable[[T], Awaitable[None]], items: Iterable[T]) -> float:
        """Do the work on all items, CONNECTIONS at a time, and return items per second."""
        waiting = iter(items)

        async def take() -> None:
            for item in waiting:
                await work(item)

        begin = perf_counter()
        await asyncio.gather(*(take() for _ in range(CONNECTIONS)))
        return self._requests / (perf_counter() - begin)


def bench_ingest(server: BenchServer, rounds: int, requests: int, seed: int) -> dict[str, Any]:
    """Return the rates of all ways over rounds of `requests` requests, in messages per second, and what they cost."""
    bench = IngestBench(server, requests, seed)
    ways = {"http": bench.through_http, "insert": bench.bare_insert, "one_by_one": bench.one_by_one}
    rates: dict[str, Rates] = interleave(ways, rounds)
    return {
        "messages_per_s": {name: rate.figures() for name, rate in rates.items()},
        "http_over_insert": rates["http"].median / rates["insert"].median,
        "passes_per_message": bench.passes_per_message,
        "message_bytes": round(bench.message_bytes),
        "messages_per_request": BATCH,
        "one_by_one": {"passes_per_message": CAR_PASSES, "processor_ms": bench.processor_ms()},
        "connections": CONNECTIONS,
    }
