"""Evidence, membership and standing are a function of the set of reports: not of order, batches or workers."""

from __future__ import annotations

import asyncio
import random
from dataclasses import dataclass
from typing import Any

import pytest
from sqlalchemy import text

from slamcu_core.geometry import LocalFrame
from slamcu_core.reports import PassReport
from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.cells import cell_at
from slamcu_server.aggregation.worker import drain

pytestmark = pytest.mark.anyio

SIGNS = tuple((200.0 * number, 0.0) for number in range(8))


@dataclass(frozen=True)
class Message:
    car: str
    session: str
    number: int
    passes: tuple[PassReport, ...]
    trusted: bool


def a_fleet(reports: Any, seed: int) -> list[Message]:
    """Cars that drive the same road for two days, see old signs, and find new ones that stand close together."""
    rng = random.Random(seed)
    there = [(200.0 * number + 40.0 + shift, 6.0) for number in range(7) for shift in (0.0, 2.4, 5.5)]
    messages = []
    for number in range(30):
        hours = rng.uniform(0.0, 48.0)
        passes = [
            (reports.missed if rng.random() < 0.4 else reports.seen)(
                one, hours=hours + 0.01 * one, weight=rng.uniform(0.0, 4.0)
            )
            for one in rng.sample(range(1, 9), 4)
        ]
        for x, y in rng.sample(there, 5):
            place = (x + rng.gauss(0.0, 0.7), y + rng.gauss(0.0, 0.7))
            if rng.random() < 0.15:
                passes.append(reports.find_missed(*place, hours=hours))
            else:
                passes.append(
                    reports.find(*place, hours=hours, weight=rng.uniform(0.1, 4.0), std_m=rng.uniform(0.3, 1.2))
                )
        passes += moved_and_modified(reports, rng, hours)
        car, trusted = f"car-{rng.randrange(12)}", rng.random() > 0.05
        messages.append(Message(car, f"session-{number}", 1 + number % 3, tuple(passes), trusted))
    return messages


def moved_and_modified(reports: Any, rng: random.Random, hours: float) -> list[PassReport]:
    """Signs that stand some metres on, or say something else: each car sees some of it, and errs now and then."""
    passes = []
    for number in rng.sample(range(1, 9), 3):
        x = 200.0 * (number - 1)
        shift, sign = (rng.gauss(0.0, 0.3), "STOP_SIGN") if number % 3 == 0 else (4.0 * (number % 3), "SPEED_LIMIT")
        passes.append(reports.missed(number, hours=hours + 0.02 * number, weight=3.0))
        if rng.random() < 0.8:
            place = (x + shift + rng.gauss(0.0, 0.4), rng.gauss(0.0, 0.4))
            passes.append(reports.find(*place, hours=hours, sign=sign, weight=rng.uniform(1.0, 4.0)))
    return passes


async def believed(town: Any) -> tuple[dict[Any, Any], dict[Any, Any], set[Any]]:
    """What is believed, named by what was reported and not by the ids that the database gave."""
    features = {
        row.object_id: _numbers(row)
        for row in await town.rows(
            "SELECT f.object_id, s.* FROM feature_states s JOIN features f ON f.id = s.feature_id"
        )
    }
    members: dict[int, set[Any]] = {}
    alone = set()
    for row in await town.rows(
        """SELECT p.candidate_id, a.label, m.session_id, m.message_id, p.index_in_message, p.status
        FROM passes p JOIN messages m ON m.id = p.message JOIN accounts a ON a.id = p.contributor_id
        WHERE p.feature_id IS NULL"""
    ):
        key = (row.label, row.session_id, row.message_id, row.index_in_message)
        if row.candidate_id is None:
            alone.add(key)
        else:
            members.setdefault(row.candidate_id, set()).add(key)
    objects = {row.id: row.object_id for row in await town.rows("SELECT id, object_id FROM features")}
    candidates = {
        frozenset(members[row.id]): _numbers(row)
        | {"pair": row.pair_kind and (row.pair_kind, objects[row.pair_feature_id])}
        for row in await town.candidates()
    }
    assert members.keys() == {row.id for row in await town.candidates()}
    return features, candidates, alone


def _numbers(row: Any) -> dict[str, Any]:
    names = ("weight_for", "weight_against", "standing", "contributors_for", "contributors_against", "passes")
    times = ("last_seen", "last_looked", "last_informative", "fades_at")
    return {name: getattr(row, name) for name in (*names, *times)}


async def clear(town: Any) -> None:
    await town.do(
        "TRUNCATE messages, passes, candidates, feature_states, changes, change_entries RESTART IDENTITY CASCADE"
    )
    await town.do("UPDATE feed_position SET last_sequence = 0")


def assert_equal(first: Any, second: Any) -> None:
    for mine, other in zip(first[:2], second[:2], strict=True):
        assert mine.keys() == other.keys()
        for key, numbers in mine.items():
            for name, number in numbers.items():
                exact = not isinstance(number, float)
                assert number == (other[key][name] if exact else pytest.approx(other[key][name], abs=1e-9, rel=1e-9))
    assert first[2] == second[2]


async def no_gap(town: Any) -> None:
    sequences = [entry.sequence for entry in await town.entries()]
    assert sequences == list(range(1, len(sequences) + 1))


@pytest.fixture
async def road(engine: Any, town: Any) -> Any:
    made = type(town)(engine, source="road")
    await made.import_map(SIGNS)
    return made


@pytest.mark.parametrize("seed", [1, 2])
async def test_order_batches_duplicates_and_workers_change_nothing(road: Any, reports: Any, seed: int) -> None:
    messages = a_fleet(reports, seed)
    rng = random.Random(seed)
    reference = None
    for workers, batch_size in ((1, 64), (1, 1), (3, 4)):
        await clear(road)
        for message in rng.sample(messages, len(messages)):
            for _ in range(rng.choice((1, 1, 2))):
                await road.report(
                    message.car,
                    *message.passes,
                    session=message.session,
                    message_id=message.number,
                    trusted=message.trusted,
                )
        done = await asyncio.gather(*(drain(road.engine, road.policy, batch_size) for _ in range(workers)))
        assert sum(one.fused for one in done) == len(messages)
        result = await believed(road)
        assert any(len(members) > 3 for members in result[1])
        assert {one["pair"][0] for one in result[1].values() if one["pair"]} == {"moved", "modified"}
        if reference is None:
            reference = result
        assert_equal(result, reference)
        assert await rebuild.differences(road.engine, road.policy) == []
        await no_gap(road)


async def test_watch_reports_follow_the_founding_pass_whatever_the_order(road: Any, reports: Any) -> None:
    first = a_fleet(reports, 3)[:20]
    for message in first:
        await road.report(message.car, *message.passes, session=message.session, message_id=message.number)
    await road.fuse()
    watched = sorted(row.id for row in await road.candidates())
    rng = random.Random(4)
    later = [
        Message(
            f"watcher-{number}",
            "w",
            1,
            tuple(
                (reports.missed if rng.random() < 0.5 else reports.seen)(key, hours=50 + number, watched=True)
                for key in rng.sample(watched, 4)
            ),
            True,
        )
        for number in range(12)
    ]
    later += [one for one in a_fleet(reports, 5)[:20] if one.session not in {two.session for two in first}]
    later += [Message(one.car, "again-" + one.session, 1, one.passes, True) for one in a_fleet(reports, 5)[:20]]
    reference = None
    async with road.engine.begin() as connection:
        for table in ("messages", "passes", "candidates", "feature_states"):
            await connection.execute(text(f"CREATE TABLE before_{table} AS TABLE {table}"))
    for workers, batch_size in ((1, 64), (1, 1), (3, 5)):
        await _restore(road)
        for message in rng.sample(later, len(later)):
            await road.report(message.car, *message.passes, session=message.session, message_id=message.number)
        await asyncio.gather(*(drain(road.engine, road.policy, batch_size) for _ in range(workers)))
        result = await believed(road)
        reference = reference or result
        assert_equal(result, reference)
        assert await rebuild.differences(road.engine, road.policy) == []


async def _restore(road: Any) -> None:
    """Take the database back to the copies made of its tables."""
    await road.do("TRUNCATE messages, passes, candidates, feature_states, changes, change_entries CASCADE")
    for table, order in (("messages", ""), ("candidates", " ORDER BY merged_into NULLS FIRST"), ("passes", "")):
        names = await road.scalar(
            "SELECT string_agg(quote_ident(column_name), ', ') FROM information_schema.columns WHERE table_name = :t",
            t=f"before_{table}",
        )
        await road.do(
            f"INSERT INTO {table} ({names}) OVERRIDING SYSTEM VALUE SELECT {names} FROM before_{table}{order}"
        )
    names = "*"
    await road.do("INSERT INTO feature_states SELECT * FROM before_feature_states")


async def test_halves_on_both_sides_of_a_lock_find_each_other(engine: Any, town: Any, reports: Any) -> None:
    # Just at the edge of a cell, so that whoever is told of one half holds another cell than who is told of the other.
    middle = reports.place(0.0, 0.0)
    edge = LocalFrame(middle.lon, middle.lat).to_local(cell_at(1, middle.lon, middle.lat).bounds[2], middle.lat)[0]
    border = type(town)(engine, source="border")
    await border.import_map([(edge - 8.0, 0.0)])
    sign = await border.scalar("SELECT object_id FROM features WHERE map_id = :m", m=border.map_id)
    for number in range(12):
        await border.report(f"miss-{number}", reports.missed(sign, hours=number))
        await border.report(f"find-{number}", reports.find(edge + 8.0, 0.0, hours=number, sign="SPEED_LIMIT"))
    await asyncio.gather(*(drain(engine, border.policy, 1) for _ in range(4)))
    assert await rebuild.differences(engine, border.policy) == []
    [candidate] = await border.candidates()
    assert candidate.pair_kind == "moved"
    assert [(row.kind, row.state) for row in await border.changes() if row.state != "withdrawn"] == [
        ("moved", "confirmed")
    ]
    await no_gap(border)


async def test_a_rebuild_changes_nothing_and_mends_what_was_broken(road: Any, reports: Any) -> None:
    for message in a_fleet(reports, 6)[:15]:
        await road.report(message.car, *message.passes, session=message.session, message_id=message.number)
    await road.fuse()
    before = await believed(road)
    assert await rebuild.rebuild(road.engine, road.policy) == 0
    assert_equal(await believed(road), before)
    await road.do("UPDATE feature_states SET weight_against = weight_against + 1e-6 WHERE feature_id % 2 = 0")
    await road.do("UPDATE candidates SET standing = NOT standing")
    assert await rebuild.differences(road.engine, road.policy)
    await rebuild.rebuild(road.engine, road.policy)
    assert await rebuild.differences(road.engine, road.policy) == []
    assert_equal(await believed(road), before)
