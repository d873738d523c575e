"""The worker is started again when it fails, and stopped when it is asked to."""

from __future__ import annotations

import asyncio

import pytest

from slamcu_server import runtime
from slamcu_server.runtime import WorkerSupervisor

pytestmark = pytest.mark.anyio


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "_FIRST_RETRY_S", 0.05)


async def test_it_runs_until_it_is_stopped() -> None:
    begun, ended = asyncio.Event(), asyncio.Event()

    async def run(stop: asyncio.Event) -> None:
        begun.set()
        await stop.wait()
        ended.set()

    supervisor = WorkerSupervisor(run)
    assert not supervisor.healthy
    supervisor.start()
    await begun.wait()
    assert supervisor.healthy
    await supervisor.stop(10)
    assert ended.is_set()
    assert not supervisor.healthy


@pytest.mark.parametrize("ending", ["raises", "returns"])
async def test_one_that_ends_is_started_again(ending: str) -> None:
    runs = 0
    third = asyncio.Event()
    health: list[bool] = []

    async def run(stop: asyncio.Event) -> None:
        nonlocal runs
        runs += 1
        health.append(supervisor.healthy)
        if runs < 3:
            if ending == "raises":
                raise ConnectionError("the database is gone")
            return
        third.set()
        await stop.wait()

    supervisor = WorkerSupervisor(run)
    supervisor.start()
    await asyncio.wait_for(third.wait(), 10)
    assert health == [True, False, False]  # until it has run for a while
    await asyncio.sleep(0.5)  # longer than the recovery, which takes the last wait, of 0.2 s
    assert supervisor.healthy
    await supervisor.stop(10)
    assert runs == 3


async def test_one_that_does_not_stop_is_cancelled() -> None:
    cancelled = asyncio.Event()

    async def run(stop: asyncio.Event) -> None:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            cancelled.set()
            raise

    supervisor = WorkerSupervisor(run)
    supervisor.start()
    await asyncio.sleep(0)
    await supervisor.stop(0.05)
    assert cancelled.is_set()


async def test_stopping_does_not_wait_for_the_next_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "_FIRST_RETRY_S", 3600.0)
    failed = asyncio.Event()

    async def run(stop: asyncio.Event) -> None:
        failed.set()
        raise ConnectionError

    supervisor = WorkerSupervisor(run)
    supervisor.start()
    await failed.wait()
    await asyncio.wait_for(supervisor.stop(3600), 10)
