"""Batches keep out of each other's way: what another one is in the way of stays in the log until its turn comes."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from slamcu_server.aggregation import batch, rebuild, worker
from slamcu_server.aggregation.locks import lock_cells
from slamcu_server.aggregation.refold import cells_of

pytestmark = pytest.mark.anyio

FAR_M = 5_000.0


@pytest.fixture
async def street(engine: Any, town: Any) -> Any:
    """Two signs whose cells are different ones."""
    made = type(town)(engine, source="street", policy=town.policy)
    await made.import_map(((0.0, 0.0), (FAR_M, 0.0)))
    return made


async def cells_at(street: Any, object_id: int) -> Any:
    [row] = await street.rows(
        """SELECT v.map_id, ST_X(v.geom) AS lon, ST_Y(v.geom) AS lat FROM features f
        JOIN feature_versions v ON v.feature_id = f.id WHERE f.object_id = :o AND f.map_id = :m""",
        o=object_id,
        m=street.map_id,
    )
    return cells_of([tuple(row)], street.policy)


async def fused_after_waiting_for(street: Any, object_id: int, limit: int = 10) -> int:
    """Hold a sign's cells, see that a batch waits for them, and return how many messages it then fuses."""
    async with street.engine.begin() as other:
        await lock_cells(other, await cells_at(street, object_id))
        waiting = asyncio.create_task(batch.process_batch(street.engine, street.policy, limit=limit))
        finished, _ = await asyncio.wait([waiting], timeout=1.0)
        assert not finished
    done: batch.Fused = await asyncio.wait_for(waiting, 20)
    return done.fused


@pytest.mark.parametrize("busy", [1, 2])
async def test_what_is_held_waits_and_the_rest_does_not(
    street: Any, reports: Any, monkeypatch: pytest.MonkeyPatch, busy: int
) -> None:
    monkeypatch.setattr(batch, "_PATIENCE", 0.0)
    for sign in (1, 2):
        await street.report(f"car-{sign}", reports.seen(sign, hours=1))
    async with street.engine.begin() as other:
        await lock_cells(other, await cells_at(street, busy))
        done = await asyncio.wait_for(batch.process_batch(street.engine, street.policy, limit=2), 20)
        assert done.fused == 1
        assert await street.feature_state(busy) is None
        assert await street.feature_state(3 - busy) is not None
    await street.fuse()
    assert await street.feature_state(busy) is not None
    assert await rebuild.differences(street.engine, street.policy) == []


async def test_what_is_put_off_calls_whoever_has_no_work(
    street: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "_PATIENCE", 0.0)
    for sign in (1, 2):
        await street.report(f"car-{sign}", reports.seen(sign, hours=1))
    async with worker._listening(street.engine) as caller:
        async with street.engine.begin() as other:
            await lock_cells(other, await cells_at(street, 1))
            assert (await batch.process_batch(street.engine, street.policy, limit=2)).fused == 1
            await asyncio.wait_for(caller.event.wait(), 20)
        caller.event.clear()
        assert (await batch.process_batch(street.engine, street.policy, limit=2)).fused == 1
        await asyncio.sleep(0.2)
        assert not caller.event.is_set()


async def test_the_oldest_is_waited_for_in_the_end(street: Any, reports: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "_PATIENCE", 1.0)
    for sign in (1, 2):
        await street.report(f"car-{sign}", reports.seen(sign, hours=1))
    assert await fused_after_waiting_for(street, 1, limit=2) == 2


async def test_who_has_little_to_do_waits_for_the_oldest(
    street: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "_PATIENCE", 0.0)
    for sign in (1, 2):
        await street.report(f"car-{sign}", reports.seen(sign, hours=1))
    assert await fused_after_waiting_for(street, 1) == 2


async def test_who_took_all_there_was_goes_on_with_what_is_free_if_it_was_much(
    street: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "_PATIENCE", 0.0)
    monkeypatch.setattr(batch, "_LITTLE", 1)
    for sign in (1, 2):
        await street.report(f"car-{sign}", reports.seen(sign, hours=1))
    async with street.engine.begin() as other:
        await lock_cells(other, await cells_at(street, 1))
        assert (await asyncio.wait_for(batch.process_batch(street.engine, street.policy, limit=10), 20)).fused == 1


async def test_where_all_is_held_a_batch_waits(street: Any, reports: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "_PATIENCE", 0.0)
    await street.report("car", reports.seen(1, hours=1))
    assert await fused_after_waiting_for(street, 1) == 1
