"""What is acknowledged is fused once, whatever happens to the workers."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Callable
from datetime import timedelta
from typing import Any

import pytest

from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.worker import forget_bodies, run_worker
from slamcu_server.metrics.instruments import Instruments

pytestmark = pytest.mark.anyio


async def fused_beyond(town: Any, count: int, process: subprocess.Popen[bytes] | None = None) -> None:
    """Wait until more than `count` messages are fused."""
    while await town.scalar("SELECT count(*) FROM messages WHERE state = 'fused'") <= count:
        assert process is None or process.poll() is None
        await asyncio.sleep(0.01)


async def test_workers_killed_in_the_middle_of_an_upload_lose_and_double_nothing(
    town: Any, reports: Any, worker: Callable[[], Any]
) -> None:
    # Every batch takes a while after it has written its passes, so that a kill comes before its commit.
    await town.do(
        """CREATE FUNCTION linger() RETURNS trigger LANGUAGE plpgsql AS
        $$ BEGIN PERFORM pg_sleep(0.15); RETURN NULL; END $$"""
    )
    await town.do("CREATE TRIGGER linger AFTER INSERT ON passes FOR EACH STATEMENT EXECUTE FUNCTION linger()")

    async def upload(numbers: range) -> None:
        for number in numbers:
            hours = number / 100  # so few hours that every pass still counts
            await town.report(
                f"car-{number % 15}",
                (reports.missed if number % 3 else reports.seen)(1, hours=hours),
                reports.find(40.0 * (number % 4) + 60, 0, hours=hours),
                session=f"s-{number}",
            )

    for begin in (0, 100):
        fused = await town.scalar("SELECT count(*) FROM messages WHERE state = 'fused'")
        with worker() as first, worker():
            await upload(range(begin, begin + 20))
            await fused_beyond(town, fused, first)
            await upload(range(begin + 20, begin + 100))  # they are at these when they are killed
    await town.do("DROP TRIGGER linger ON passes")
    await town.fuse()
    states = await town.rows("SELECT state, count(*) AS n FROM messages GROUP BY state")
    assert [(row.state, row.n) for row in states] == [("fused", 200)]
    assert await town.scalar("SELECT count(*) FROM passes") == 400
    assert await rebuild.differences(town.engine, town.policy) == []
    sequences = [entry.sequence for entry in await town.entries()]
    assert sequences == list(range(1, len(sequences) + 1))


async def test_a_worker_is_woken_by_what_is_logged_and_stops_when_asked(
    town: Any, reports: Any, settings: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamcu_server.aggregation.worker.POLL_S", 60.0)
    instruments = Instruments()
    stop = asyncio.Event()
    running = asyncio.create_task(run_worker(town.engine, settings, stop, instruments=instruments))
    await asyncio.sleep(0.3)  # it waits by now, if it does not poll
    await town.report("a", reports.missed(1, hours=0))
    async with asyncio.timeout(20):
        await fused_beyond(town, 0)
    stop.set()
    await asyncio.wait_for(running, 20)
    assert instruments.registry.get_sample_value("slamcu_aggregation_messages_total", {"outcome": "fused"}) == 1.0
    assert await town.scalar("SELECT count(*) FROM policies") == 1


async def test_a_worker_says_so_when_its_database_goes(town: Any, settings: Any) -> None:
    running = asyncio.create_task(run_worker(town.engine, settings, asyncio.Event()))
    await asyncio.sleep(0.3)
    await town.do(
        """SELECT pg_terminate_backend(pid) FROM pg_stat_activity
        WHERE pid <> pg_backend_pid() AND datname = current_database()"""
    )
    await town.report("a")
    # its supervisor starts it again; meanwhile nothing is put aside
    done, _ = await asyncio.wait({running}, timeout=20)
    assert done
    assert running.exception() is not None
    assert await town.scalar("SELECT count(*) FROM messages WHERE state = 'quarantined'") == 0


async def test_bodies_are_forgotten_in_time_and_identities_are_not(town: Any, reports: Any) -> None:
    await town.report("a", reports.missed(1, hours=0))
    await town.fuse()
    await town.report("b", reports.missed(1, hours=0))
    assert await forget_bodies(town.engine, timedelta(days=1)) == 0
    assert await forget_bodies(town.engine, timedelta(0)) == 1
    rows = await town.rows("SELECT state, body IS NULL AS empty, sha256 IS NOT NULL AS known FROM messages ORDER BY id")
    assert [tuple(row) for row in rows] == [("fused", True, True), ("pending", False, True)]
    await town.report("a", reports.missed(1, hours=0), message_id=1)  # sent again: known, not fused again
    await town.fuse()
    assert (await town.feature_state(1)).passes == 2


async def test_a_group_that_reaches_beyond_the_locked_cells_is_folded_whole(town: Any, reports: Any) -> None:
    """The middle of the town is where two rows of cells meet: a chain of finds crosses it."""
    for number, y in enumerate((-9.0, -5.0, -1.0, 3.0, 7.0)):
        await town.report(f"car-{number}", reports.find(50, y, hours=number, std_m=1.5))
        await town.fuse(batch_size=1)
    await town.report("again", reports.find(50, -9.5, hours=10, std_m=1.5))
    await town.report("yonder", reports.find(50, 7.5, hours=10, std_m=1.5))
    await asyncio.gather(town.fuse_some(batch_size=1), town.fuse_some(batch_size=1))
    assert await town.scalar("SELECT count(*) FROM passes WHERE candidate_id IS NOT NULL") == 7
    assert await rebuild.differences(town.engine, town.policy) == []


async def test_old_passes_leave_once_no_fold_needs_them(town: Any, reports: Any) -> None:
    window = town.policy.default.window
    for number in range(window + 20):
        await town.report(f"car-{number % 7}", reports.seen(1, hours=number))
        if number % 12 == 0:
            await town.fuse()
    await town.fuse()
    assert await town.scalar("SELECT count(*) FROM passes") == window
    before = await town.feature_state(1)
    await town.report("late", reports.missed(1, hours=2))  # older than all that counts
    await town.fuse()
    after = await town.feature_state(1)
    assert (after.weight_for, after.weight_against, after.passes) == (
        before.weight_for,
        before.weight_against,
        before.passes,
    )
    assert await rebuild.differences(town.engine, town.policy) == []
