"""Evidences a second from acknowledged to fused, beside what the same PostGIS does at best with its parts.

The log is filled at one stroke, which is when its messages are acknowledged, and the clock runs until no message waits.
The workers are processes of the server that listen already. What they are compared with takes turns with them: a
batched additive upsert (the least that adding evidence can be) and a spatial match of 1,000 points (the least that
finding out what evidence is about can be), each by one connection that does nothing else.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import Any

import asyncpg
import numpy as np

from slamcu_eval.bench import processor
from slamcu_eval.bench.cloud import Cloud
from slamcu_eval.bench.rounds import interleave
from slamcu_eval.bench.traffic import place
from slamcu_eval.bench.workers import backends, until_fused, working
from slamcu_server.database.embedded import EmbeddedCluster

_AT_ONCE = 1_000
_CEILING_S = 3.0
"""A ceiling is measured this long: in less, a busy machine lets it go first, as its scheduler does with newcomers."""
_REACH_DEG = 5.0 / 110_500.0
_UPSERT = """
INSERT INTO ceiling (id, f, a) SELECT * FROM unnest($1::bigint[], $2::float8[], $3::float8[])
ON CONFLICT (id) DO UPDATE SET f = ceiling.f + EXCLUDED.f, a = ceiling.a + EXCLUDED.a"""
# bbox first, then the distance: the fastest of three ways to match
_MATCH = """
SELECT p.n, v.feature_id FROM unnest($1::int[], $2::float8[], $3::float8[]) AS p (n, lon, lat)
JOIN feature_versions v ON v.to_sequence IS NULL
    AND v.geom && ST_MakeEnvelope(p.lon - 1.5 * $4, p.lat - $4, p.lon + 1.5 * $4, p.lat + $4, 4326)
    AND ST_Distance(v.geom::geography, ST_SetSRID(ST_MakePoint(p.lon, p.lat), 4326)::geography) <= 5.0"""


@dataclass(frozen=True, slots=True)
class Load:
    """How much is measured."""

    messages: int  # that wait when a round begins
    rounds: int
    seed: int


class AggregationBench:
    """The ways of working on one database: workers on its log, and the raw parts."""

    def __init__(self, cloud: Cloud, load: Load) -> None:
        self._cloud, self._messages = cloud, load.messages
        self._rng = np.random.default_rng(load.seed)
        self.passes = 0
        self._used: dict[str, list[float]] = {}

    def fused_by(self, workers: int) -> Callable[[], float]:
        """Return the way that fuses one round of messages by some workers, in evidences per second."""
        return lambda: asyncio.run(self._fuse(workers))

    def upsert(self) -> float:
        """Add to rows of a table of weights as large as the map, a batch at a time, and return rows per second."""
        return asyncio.run(self._upsert())

    def match(self) -> float:
        """Match points against the map, a batch at a time, and return points per second."""
        return asyncio.run(self._match())

    async def _fuse(self, workers: int) -> float:
        connection = await self._cloud.connect()
        try:
            async with working(self._cloud.url, workers, connection) as pids:
                served = set(await backends(connection))
                before = processor.seconds(pids), processor.seconds(served)
                self.passes = await self._cloud.fill_log(connection, self._messages)
                begin = perf_counter()
                await until_fused(connection)
                took = perf_counter() - begin
                self._note("worker", processor.seconds(pids) - before[0], self.passes)
                served.update(await backends(connection))  # a worker connects once more when it begins
                self._note("database", processor.seconds(served) - before[1], self.passes)
                return self.passes / took
        finally:
            await connection.close()

    async def _upsert(self) -> float:
        connection = await self._cloud.connect()
        try:
            await connection.execute(
                "CREATE TABLE IF NOT EXISTS ceiling (id bigint PRIMARY KEY, f float8, a float8) WITH (fillfactor = 70)"
            )
            features = min(self._cloud.features, 1_000_000)

            def batch() -> Sequence[Any]:
                ids = np.sort(self._rng.choice(features, min(_AT_ONCE, features), replace=False)).tolist()
                return ids, [1.0] * len(ids), [0.1] * len(ids)

            return await self._rate("upsert", connection, _UPSERT, batch)
        finally:
            await connection.close()

    async def _match(self) -> float:
        connection = await self._cloud.connect()
        try:

            def batch() -> Sequence[Any]:
                places = [place(int(number)) for number in self._rng.integers(self._cloud.features, size=_AT_ONCE)]
                lon, lat = (list(column) for column in zip(*places, strict=True))
                return list(range(_AT_ONCE)), lon, lat, _REACH_DEG

            return await self._rate("match", connection, _MATCH, batch)
        finally:
            await connection.close()

    async def _rate(
        self, name: str, connection: asyncpg.Connection[Any], statement: str, batch: Callable[[], Sequence[Any]]
    ) -> float:
        """Run a statement for one batch after the other, each its own transaction, and return rows per second."""
        prepared = await connection.prepare(statement)
        await prepared.fetch(*batch())
        server = [await connection.fetchval("SELECT pg_backend_pid()")]
        before, rows, took = processor.seconds(server), 0, 0.0
        while took < _CEILING_S:
            arguments = batch()
            begin = perf_counter()
            await prepared.fetch(*arguments)
            took += perf_counter() - begin
            rows += len(arguments[0])
        self._note(name, processor.seconds(server) - before, rows)
        return rows / took

    def processor_time(self) -> dict[str, float]:
        """Return the processor time in µs of an evidence, or a row, by who used it: medians over the rounds."""
        return {name: median(values) for name, values in self._used.items()}

    def _note(self, name: str, seconds: float, rows: int) -> None:
        self._used.setdefault(name, []).append(1e6 * seconds / rows)


def bench_aggregation(cluster: EmbeddedCluster, features: int, stored_per_feature: int, load: Load) -> dict[str, Any]:
    """Return the rates of one and of two workers and of both ceilings, in turn, and what share the workers reach."""
    cloud = asyncio.run(
        Cloud.make(cluster, "bench_aggregation", features, seed=load.seed, stored_per_feature=stored_per_feature)
    )
    bench = AggregationBench(cloud, load)
    rates = interleave(
        {
            "one_worker": bench.fused_by(1),
            "two_workers": bench.fused_by(2),
            "upsert": bench.upsert,
            "match": bench.match,
        },
        load.rounds,
    )
    slower = min(rates["upsert"].median, rates["match"].median)
    return {
        "per_s": {name: rate.figures() for name, rate in rates.items()},
        "two_workers_over_slower_ceiling": rates["two_workers"].median / slower,
        "processor_us": bench.processor_time(),
        "map_features": features,
        "stored_contributions": features * stored_per_feature,
        "messages_per_round": load.messages,
        "passes_per_message": bench.passes / load.messages,
    }
