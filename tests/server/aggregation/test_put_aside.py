"""What fails for a lasting reason is put aside with the reason, and nothing else waits for it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import timedelta
from typing import Any

import httpx
import pytest

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import aside, rebuild, worker
from slamcu_server.aggregation.aside import Work
from slamcu_server.aggregation.fading import fade
from slamcu_server.logs import DiscreetFormatter
from slamcu_server.metrics.instruments import Instruments
from slamcu_server.retraction import corrections, marks, repository
from slamcu_server.retraction.filter import EvidenceFilter
from slamcu_server.settings import Settings

pytestmark = pytest.mark.anyio

SIGNS = tuple((150.0 * number, 0.0) for number in range(5))
SECRET = "2.1048"


@pytest.fixture
async def road(engine: Any, town: Any) -> Any:
    made = type(town)(engine, Policy(), source="road")
    await made.import_map(SIGNS)
    return made


async def fail(road: Any, table: str, when: str, state: str = "22003", times: int = 2**31) -> None:
    """Let the database refuse to write some rows of a table, so many times."""
    await road.do("CREATE SEQUENCE faults")
    await road.do(
        f"""CREATE FUNCTION fail() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        IF nextval('faults') <= {times} THEN
            RAISE EXCEPTION 'the vehicle was at {SECRET}' USING ERRCODE = '{state}';
        END IF; RETURN NEW; END $$"""
    )
    await road.do(
        f"CREATE TRIGGER fail BEFORE INSERT OR UPDATE ON {table} FOR EACH ROW WHEN ({when}) EXECUTE FUNCTION fail()"
    )


async def repair(road: Any) -> None:
    await road.do("DROP FUNCTION fail CASCADE")


async def retract(road: Any, car: str) -> int:
    async with road.engine.begin() as connection:
        await marks.hold_alone(connection)
        names = EvidenceFilter(contributor_id=await road.account(car))
        return await repository.add(connection, names, "a test", None)


async def put_aside(road: Any) -> list[tuple[str, int]]:
    async with road.engine.begin() as connection:
        return [(one.work, one.attempts) for one in await aside.list_all(connection)]


async def feature(road: Any, object_id: int) -> int:
    return int(
        await road.scalar("SELECT id FROM features WHERE map_id = :m AND object_id = :o", m=road.map_id, o=object_id)
    )


async def looked(road: Any) -> list[int]:
    return [state.passes if (state := await road.feature_state(one)) else 0 for one in range(1, 6)]


@asynccontextmanager
async def working(road: Any, settings: Settings) -> AsyncIterator[Instruments]:
    """Run a worker, which must not fail."""
    stop, instruments = asyncio.Event(), Instruments()
    running = asyncio.create_task(worker.run_worker(road.engine, settings, stop, instruments=instruments))
    try:
        yield instruments
    finally:
        stop.set()
        await asyncio.wait_for(running, 30)


async def until(road: Any, number: int, query: str) -> None:
    """Wait until a query counts so many."""
    async with asyncio.timeout(30):
        while True:
            if await road.scalar(query) == number:
                return
            await asyncio.sleep(0.05)


FUSED = "SELECT count(*) FROM messages WHERE state = 'fused'"


async def test_a_correction_that_fails_keeps_nobody_waiting(
    *,
    road: Any,
    reports: Any,
    settings: Settings,
    client: httpx.AsyncClient,
    admin: dict[str, str],
    command: Any,
    caplog: pytest.LogCaptureFixture,
) -> None:
    for car in ("liar", "honest"):
        await road.report(car, *(reports.seen(one, hours=0.0) for one in range(1, 6)))
    await road.fuse()
    await fail(road, "feature_states", f"NEW.feature_id = {await feature(road, 3)}")
    retraction = await retract(road, "liar")
    url = f"/v1/evidence/retractions/{retraction}"
    caplog.handler.setFormatter(DiscreetFormatter("%(message)s"))
    with caplog.at_level(logging.INFO):
        async with working(road, settings) as instruments:
            await until(road, 1, "SELECT count(*) FROM put_aside")
            await road.report("later", reports.seen(1, hours=1.0))
            await until(road, 3, FUSED)
            assert await looked(road) == [2, 1, 2, 1, 1]
    assert instruments.chores_failed.labels("correcting")._value.get() == 0
    shown = (await client.get(url, headers=admin)).json()
    assert (shown["state"], shown["passes"], shown["put_aside"]) == ("applying", 5, 1)
    assert 'slamcu_put_aside{work="correction"} 1.0' in (await client.get("/metrics")).text
    [(error,)] = await road.rows("SELECT error FROM put_aside")
    assert "22003" in error
    assert "is put aside" in caplog.text
    assert SECRET not in error + caplog.text
    assert await rebuild.differences(road.engine, road.policy) == []  # what was not corrected is as it was
    checked = await asyncio.to_thread(command, "check")
    assert (checked.returncode, "correction" in checked.stdout) == (1, True)

    assert await corrections.correct(road.engine, road.policy) is False  # not before its time
    await repair(road)
    told = await asyncio.to_thread(command, "retry")
    assert told.stdout.split("\t")[0] == "correction"
    await corrections.correct_all(road.engine, road.policy)
    assert await looked(road) == [2, 1, 1, 1, 1]
    assert (await client.get(url, headers=admin)).json()["state"] == "applied"
    assert await put_aside(road) == []
    assert (await asyncio.to_thread(command, "check")).returncode == 0


async def test_what_failed_is_tried_again_later_each_time(road: Any, reports: Any) -> None:
    await road.report("liar", reports.seen(3, hours=0.0), reports.seen(4, hours=0.0))
    await road.fuse()
    await fail(road, "feature_states", f"NEW.feature_id = {await feature(road, 3)}")
    await retract(road, "liar")
    pauses = []
    for attempt in range(1, 13):
        await corrections.correct_all(road.engine, road.policy)
        assert await put_aside(road) == [("correction", attempt)]
        pauses.append(await road.scalar("SELECT retry_at - failed_at FROM put_aside"))
        await road.do("UPDATE put_aside SET retry_at = now()")
    assert pauses[:4] == [timedelta(minutes=2**number) for number in range(4)]
    assert pauses[-1] == timedelta(hours=6)
    await repair(road)
    await corrections.correct_all(road.engine, road.policy)
    assert (await put_aside(road), await looked(road)) == ([], [0, 0, 0, 0, 0])


@pytest.mark.parametrize("state", ["40001", "55P03", "57014"])
async def test_what_passes_is_tried_again_at_once_and_not_put_aside(road: Any, reports: Any, state: str) -> None:
    await road.report("liar", reports.seen(3, hours=0.0))
    await road.fuse()
    await fail(road, "feature_states", "true", state, times=2)
    await retract(road, "liar")
    await corrections.correct_all(road.engine, road.policy)
    assert (await put_aside(road), await looked(road)) == ([], [0, 0, 0, 0, 0])


async def test_a_retraction_that_cannot_be_listed_keeps_no_other_waiting(road: Any, reports: Any) -> None:
    for car in ("liar", "lost"):
        await road.report(car, reports.seen(1, hours=0.0), reports.seen(2, hours=0.0))
    await road.fuse()
    first = await retract(road, "liar")
    await fail(road, "corrections", f"NEW.retraction_id = {first}")
    await retract(road, "lost")
    await corrections.correct_all(road.engine, road.policy)
    states = "SELECT state FROM retractions ORDER BY id"
    assert [row.state for row in await road.rows(states)] == ["requested", "applied"]
    assert (await put_aside(road), await looked(road)) == ([(Work.RETRACTION, 1)], [1, 1, 0, 0, 0])
    await repair(road)
    await road.do("UPDATE put_aside SET retry_at = now()")
    await corrections.correct_all(road.engine, road.policy)
    assert [row.state for row in await road.rows(states)] == ["applied", "applied"]
    assert (await put_aside(road), await looked(road)) == ([], [0, 0, 0, 0, 0])


async def test_a_change_that_cannot_fade_keeps_no_other_waiting(road: Any, reports: Any) -> None:
    for x in (40.0, 190.0, 340.0):
        for car in ("a", "b", "c"):
            await road.report(car, reports.find(x, 9.0, hours=-24.0 * 365 * 5))
    await road.report("d", reports.seen(1, hours=0.0))
    await road.fuse()
    await fail(road, "changes", "NEW.id = 2")
    assert await fade(road.engine, road.policy) == 2
    assert [change.state for change in await road.changes()] == ["withdrawn", "confirmed", "withdrawn"]
    assert await put_aside(road) == [(Work.FADING, 1)]
    assert await fade(road.engine, road.policy) == 0
    await repair(road)
    await road.do("UPDATE put_aside SET retry_at = now()")
    assert await fade(road.engine, road.policy) == 1
    assert await put_aside(road) == []


async def test_a_change_that_need_not_fade_any_more_is_forgotten(road: Any, reports: Any) -> None:
    for car in ("a", "b", "c"):
        await road.report(car, reports.find(40.0, 9.0, hours=-24.0 * 365 * 5))
    await road.report("d", reports.seen(1, hours=0.0))
    await road.fuse()
    await fail(road, "changes", "NEW.id = 1")
    assert await fade(road.engine, road.policy) == 0
    await repair(road)
    for car in ("a", "b", "c"):
        await road.report(car, reports.find(40.0, 9.0, hours=1.0))
    await road.fuse()
    await road.do("UPDATE put_aside SET retry_at = now()")
    assert await fade(road.engine, road.policy) == 0
    assert await put_aside(road) == []


async def test_a_chore_that_fails_keeps_no_report_waiting(
    road: Any, reports: Any, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def broken(*_: object, **__: object) -> None:
        raise ValueError("a chore")

    for name in ("forget_archived", "fade", "correct", "recompute"):
        monkeypatch.setattr(worker, name, broken)
    async with working(road, settings.model_copy(update={"trust_interval_s": 0.01})) as instruments:
        for number in range(3):
            await road.report("car", reports.seen(1, hours=float(number)))
            await until(road, number + 1, FUSED)
    failed = {
        name: instruments.chores_failed.labels(name)._value.get()
        for name in ("correcting", "fading", "forgetting", "trusting")
    }
    assert {name: count >= 1 for name, count in failed.items()} == dict.fromkeys(failed, True)
    assert (failed["correcting"], failed["fading"], failed["forgetting"]) == (1, 1, 1)  # not again and again


async def test_quarantined_messages_are_fused_after_a_repair(road: Any, reports: Any, command: Any) -> None:
    await fail(road, "feature_states", f"NEW.feature_id = {await feature(road, 3)}")
    await road.report("a", reports.seen(3, hours=0.0))
    await road.fuse()
    await repair(road)
    assert "0 quarantined" in (await asyncio.to_thread(command, "retry")).stderr
    assert "1 quarantined" in (await asyncio.to_thread(command, "retry", "--messages")).stderr
    await road.fuse()
    assert await looked(road) == [0, 0, 1, 0, 0]
