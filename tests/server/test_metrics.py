"""What a server and a worker tell those who watch them."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Callable

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_server.app import create_worker_app
from slamcu_server.metrics.instruments import Instruments
from slamcu_server.runtime import WorkerSupervisor

pytestmark = pytest.mark.anyio


def _gauges(text: str) -> dict[tuple[str, ...], float]:
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


async def test_a_server_tells_of_backlog_feed_and_connections(client: httpx.AsyncClient) -> None:
    found = _gauges((await client.get("/metrics")).text)
    assert found["slamcu_aggregation_pending_messages",] == 0
    assert found["slamcu_aggregation_quarantined_messages",] == 0
    assert found["slamcu_aggregation_lag_seconds",] == 0
    assert found["slamcu_feed_last_sequence",] == 0
    assert found["slamcu_database_pool_size",] == 10
    assert found["slamcu_database_connections", "busy"] == 1, "the one that answers this"
    assert found["slamcu_worker_healthy",] == 0, "this process has none"


async def test_a_worker_answers_how_it_is(engine: AsyncEngine) -> None:
    async def run(stop: asyncio.Event) -> None:
        await stop.wait()

    worker = WorkerSupervisor(run)
    app = create_worker_app(engine, worker, Instruments())
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://slamcu.test") as client:
        assert (await client.get("/readyz")).status_code == 503
        worker.start()
        assert (await client.get("/readyz")).json() == {"status": "ready"}
        assert _gauges((await client.get("/metrics")).text)["slamcu_worker_healthy",] == 1
        assert (await client.get("/v1/maps")).status_code == 404
        await worker.stop(1.0)
        answer = await client.get("/readyz")
    assert answer.status_code == 503
    assert "worker" in answer.json()["detail"]


def test_a_worker_s_port_in_use_is_told(command: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    done = command("worker", SLAMCU_HOST="host.invalid", SLAMCU_WORKER_PORT="9000")
    assert done.returncode == 1
    assert "cannot listen on host.invalid port 9000" in done.stderr
