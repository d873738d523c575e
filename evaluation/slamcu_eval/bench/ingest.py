"""Messages a second through HTTP into the durable log, beside the bare insert of the same bytes into the same table."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from itertools import count
from time import perf_counter
from typing import Any, TypeVar

import asyncpg
import httpx
import numpy as np

from slamcu_core.errors import SlamcuError
from slamcu_core.sensoris import join_batch, serialize_message
from slamcu_eval.bench.rounds import Rates, interleave
from slamcu_eval.bench.server import BenchServer
from slamcu_eval.bench.traffic import Traffic

T = TypeVar("T")

CONNECTIONS = 4  # requests, or inserts, under way at a time
BATCH = 25  # messages per request, and per insert

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

    def through_http(self) -> float:
        """Post one round of batches and return messages per second."""
        return asyncio.run(self._post(self._round()))

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

            return await self._rate(post, bodies)

    async def _insert(self, batches: list[_Batch]) -> float:
        url = self._server.database_url.replace("+asyncpg", "")
        async with asyncpg.create_pool(url, min_size=CONNECTIONS, max_size=CONNECTIONS) as pool:
            accounts = [row["id"] for row in await pool.fetch("SELECT id FROM accounts ORDER BY id")]

            async def insert(batch: _Batch) -> None:
                hashes = [hashlib.sha256(message).digest() for message in batch.messages]
                numbers = list(range(1, len(batch.messages) + 1))
                sessions = [batch.session] * len(batch.messages)
                await pool.execute(_INSERT, accounts[batch.vehicle], sessions, numbers, hashes, batch.messages)

            return await self._rate(insert, batches)

    async def _rate(self, work: Callable[[T], Awaitable[None]], items: Iterable[T]) -> float:
        """Do the work on all items, CONNECTIONS at a time, and return messages per second."""
        waiting = iter(items)

        async def take() -> None:
            for item in waiting:
                await work(item)

        begin = perf_counter()
        await asyncio.gather(*(take() for _ in range(CONNECTIONS)))
        return self._requests * BATCH / (perf_counter() - begin)


def bench_ingest(server: BenchServer, rounds: int, requests: int, seed: int) -> dict[str, Any]:
    """Return the rates of both ways over rounds of `requests` batches, in messages per second, and their ratio."""
    bench = IngestBench(server, requests, seed)
    rates: dict[str, Rates] = interleave({"http": bench.through_http, "insert": bench.bare_insert}, rounds)
    return {
        "messages_per_s": {name: rate.figures() for name, rate in rates.items()},
        "http_over_insert": rates["http"].median / rates["insert"].median,
        "passes_per_message": bench.passes_per_message,
        "message_bytes": round(bench.message_bytes),
        "messages_per_request": BATCH,
        "connections": CONNECTIONS,
    }
