"""How long it takes from the acknowledgement of a report until the feed shows what it changes, under steady traffic.

Traffic is logged at a given rate while two workers aggregate. Now and then a probe goes the whole way: a find where
nobody has found anything is posted to the API, and the feed is asked over HTTP until it tells of it.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import httpx
import numpy as np

from slamcu_core.errors import SlamcuError
from slamcu_core.sensoris import encode_batch
from slamcu_eval.bench.cloud import INSERT, Cloud, quantiles
from slamcu_eval.bench.traffic import Traffic
from slamcu_eval.bench.workers import until_fused, working
from slamcu_server.aggregation.log import CHANNEL

_TICK_S = 0.25  # between two strokes of traffic
_PROBE_S = 0.4
_LOOK_S = 0.05
_PATIENCE_S = 60.0
_PROBE_LAT = 47.0  # south of the map


@dataclass
class _Probes:
    """When probes were acknowledged and when the feed showed them, by number."""

    acknowledged: dict[int, float] = field(default_factory=dict)
    seen: dict[int, float] = field(default_factory=dict)
    last: asyncio.Event = field(default_factory=asyncio.Event)  # set when nothing waits any more


def bench_latency(cloud: Cloud, url: str, keys: tuple[str, str], per_s: float, seconds: float) -> dict[str, Any]:
    """Return the time to visibility at a rate of evidences a second.

    Parameters
    ----------
    keys : of a vehicle and of a provider.
    """
    return asyncio.run(_run(cloud, url, keys, per_s, seconds))


async def _run(cloud: Cloud, url: str, keys: tuple[str, str], per_s: float, seconds: float) -> dict[str, Any]:
    connection, looker = await cloud.connect(), await cloud.connect()
    try:
        rows, passes = await cloud.bodies(connection, max(1, round(per_s * seconds / 21.3)))
        async with working(cloud.url, 2, looker), httpx.AsyncClient(base_url=url, timeout=30.0) as client:
            probes = _Probes()
            watching = asyncio.create_task(_watch(client, keys[1], probes))
            probing = asyncio.create_task(_probe(client, keys[0], cloud.seed, seconds, probes))
            begin = perf_counter()
            done = 0
            while done < len(rows):
                due = min(len(rows), round((perf_counter() - begin + _TICK_S) / seconds * len(rows)))
                if due > done:
                    await connection.execute(INSERT, *zip(*rows[done:due], strict=True))
                    await connection.execute("SELECT pg_notify($1, '')", CHANNEL)
                done = due
                await asyncio.sleep(_TICK_S)
            took = perf_counter() - begin
            await probing
            await until_fused(looker)
            probes.last.set()
            await asyncio.wait_for(watching, _PATIENCE_S)
        missing = len(probes.acknowledged) - len(probes.seen)
        if missing:
            raise SlamcuError(f"{missing} probes never came into the feed")
        waits = [probes.seen[number] - at for number, at in probes.acknowledged.items()]
        return {"evidences_per_s": passes / took, "seconds": quantiles(waits), "probes": len(waits)}
    finally:
        await connection.close()
        await looker.close()


async def _probe(client: httpx.AsyncClient, key: str, seed: int, seconds: float, probes: _Probes) -> None:
    rng, traffic = np.random.default_rng((seed, 1)), Traffic(20, {})
    headers = {"Authorization": f"Bearer {key}", "Content-Type": "application/x-protobuf"}
    begin = perf_counter()
    number = 0
    while perf_counter() - begin < seconds:
        (report,) = traffic.messages(0, 0, 1, rng)
        find = next(one for one in report.passes if one.reference is None)
        if find.position is None:
            raise SlamcuError("a find has a position")
        lon = 2.0 + 0.001 * number
        moved = replace(find, position=replace(find.position, lon=lon, lat=_PROBE_LAT))
        body = encode_batch([replace(report, session_id=f"probe-{number}", passes=(moved,))])
        answer = await client.post("/v1/data-messages", content=body, headers=headers)
        answer.raise_for_status()
        probes.acknowledged[number] = perf_counter()
        number += 1
        await asyncio.sleep(_PROBE_S)


async def _watch(client: httpx.AsyncClient, key: str, probes: _Probes) -> None:
    headers, after = {"Authorization": f"Bearer {key}"}, 0
    box = f"1.9,{_PROBE_LAT - 0.01},2.9,{_PROBE_LAT + 0.01}"
    over = False
    while not over:
        over = probes.last.is_set()  # what the feed says after that is all
        answer = await client.get("/v1/changes", params={"after": after, "bbox": box}, headers=headers)
        answer.raise_for_status()
        now = perf_counter()
        for entry in answer.json()["entries"]:
            after = max(after, entry["sequence"])
            probes.seen.setdefault(round((entry["change"]["geometry"]["coordinates"][0] - 2.0) / 0.001), now)
        await asyncio.sleep(_LOOK_S)
