"""Cars that flag themselves: many who doubt in one place are heard, lost ones and liars are not, in whatever order."""

from __future__ import annotations

import asyncio
import random
from dataclasses import dataclass
from typing import Any

import pytest

from slamcu_core.aggregation import ClassPolicy, Policy
from slamcu_core.reports import PassReport
from slamcu_server.accounts.schemas import ALL_MAPS
from slamcu_server.accounts.times import TimesTold
from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.worker import drain
from slamcu_server.changes import service
from slamcu_server.retraction import corrections, marks, repository
from slamcu_server.retraction.filter import EvidenceFilter
from slamcu_server.trust.job import recompute

pytestmark = pytest.mark.anyio

SIGNS = tuple((100.0 * number, 0.0) for number in range(6))
GONE, CHANGED, STAYS = (2, 3), 4, (1, 5, 6)  # object ids: roadworks about the middle of the road
NEW = (150.0, 6.0)


@pytest.fixture
async def road(engine: Any, town: Any) -> Any:
    made = type(town)(engine, source="road")
    await made.import_map(SIGNS)
    return made


def in_the_roadworks(reports: Any, hours: float, rng: random.Random) -> list[PassReport]:
    """What a car says that knows where it is, and doubts it."""

    def near(x: float, y: float) -> tuple[float, float]:
        return x + rng.gauss(0.0, 0.4), y + rng.gauss(0.0, 0.4)

    return [
        *(reports.missed(sign, hours=hours) for sign in (*GONE, CHANGED)),
        reports.find(*near(100.0 * (CHANGED - 1), 0.0), hours=hours),
        reports.find(*near(*NEW), hours=hours, sign="YIELD"),
    ]


def lost(reports: Any, hours: float, rng: random.Random) -> list[PassReport]:
    """What a car says that is anywhere: it misses the whole map, and finds everything somewhere else."""
    aside = rng.uniform(-25.0, 25.0), rng.uniform(-25.0, 25.0)
    return [
        *(reports.missed(sign, hours=hours) for sign in range(1, 7)),
        *(reports.find(x + aside[0], y + aside[1], hours=hours, sign="SPEED_LIMIT") for x, y in SIGNS),
    ]


async def confirmed(road: Any) -> set[tuple[str, int | None]]:
    return {(one.kind, one.document["map_object_id"]) for one in await road.changes() if one.state == "confirmed"}


async def test_roadworks_are_told_by_cars_that_all_doubt_in_one_place(road: Any, reports: Any) -> None:
    rng = random.Random(1)
    for number in range(4):
        assert await confirmed(road) == set()
        car, hours = f"car-{number}", 2.0 * number
        await road.report(car, reports.seen(1, hours=hours), session="before")
        await road.report(car, *in_the_roadworks(reports, hours, rng), session="within", trusted=False)
        await road.report(car, reports.seen(5, hours=hours), reports.seen(6, hours=hours), session="after")
        await road.fuse()
    told = {("deleted", GONE[0]), ("deleted", GONE[1]), ("modified", CHANGED), ("new", None)}
    assert await confirmed(road) == told
    assert await rebuild.differences(road.engine, road.policy) == []


async def test_lost_cars_tell_nothing_though_they_flag_the_same_signs(road: Any, reports: Any) -> None:
    rng = random.Random(2)
    for number in range(12):
        hours = 2.0 * number
        await road.report(f"lost-{number}", *lost(reports, hours, rng), trusted=False)
        if number % 3 == 2:
            await road.report(f"car-{number}", *(reports.seen(sign, hours=hours + 1) for sign in range(1, 7)))
    await road.fuse()
    assert await road.changes() == []
    assert [row.first_seen for row in await road.candidates() if row.first_seen is not None] == []
    for sign in range(1, 7):
        state = await road.feature_state(sign)
        assert (state.weight_against, state.looked) == (0.0, 4)
    assert await rebuild.differences(road.engine, road.policy) == []


async def test_liars_gain_nothing_by_flagging_themselves(road: Any, reports: Any) -> None:
    """Three who collude, hour after hour, against what one honest stranger sees."""
    for hours in range(0, 30, 3):
        for liar in range(3):
            lie = (reports.missed(1, hours=hours), reports.find(30.0, 0.0, hours=hours))
            await road.report(f"liar-{liar}", *lie, trusted=False)
    await road.fuse()
    assert await road.changes() == []
    before = await road.feature_state(1)
    assert before.weight_against == 0.0
    # nor do they keep others from telling what is so
    for number in range(4):
        await road.report(f"car-{number}", reports.missed(2, hours=number))
        await road.report(f"liar-{number % 3}", reports.seen(2, hours=number + 0.5), trusted=False)
    await road.fuse()
    assert await confirmed(road) == {("deleted", 2)}
    assert await rebuild.differences(road.engine, road.policy) == []


async def test_trust_is_recomputed_where_nobody_has_spoken_but_in_doubt(road: Any, reports: Any) -> None:
    rng = random.Random(5)
    for number in range(4):
        await road.report(f"car-{number}", *in_the_roadworks(reports, 2.0 * number, rng), trusted=False)
    await road.fuse()
    assert (await recompute(road.engine)).version in (None, 0)  # flags are not judged, and give no record


async def retract(road: Any, car: str) -> int:
    async with road.engine.begin() as connection:
        await marks.hold_alone(connection)
        number = await repository.add(
            connection, EvidenceFilter(contributor_id=await road.account(car)), "a test", None
        )
    await corrections.correct_all(road.engine, road.policy)
    return number


async def test_what_was_said_in_doubt_is_taken_out_exactly_and_comes_back(road: Any, reports: Any) -> None:
    rng = random.Random(3)
    for number in range(4):
        await road.report(f"car-{number}", *in_the_roadworks(reports, 2.0 * number, rng), trusted=False)
    await road.fuse()
    assert len(await confirmed(road)) == 4
    retraction = await retract(road, "car-0")  # which has founded all that was found
    assert await confirmed(road) == set()
    assert await rebuild.differences(road.engine, road.policy) == []
    async with road.engine.begin() as connection:
        await marks.hold_alone(connection)
        await repository.request_undo(connection, retraction, "a test", None)
    await corrections.correct_all(road.engine, road.policy)
    assert len(await confirmed(road)) == 4
    await retract(road, "car-1")
    await road.report("car-9", *in_the_roadworks(reports, 9.0, rng), trusted=False)
    await road.fuse()
    assert len(await confirmed(road)) == 4
    assert await rebuild.differences(road.engine, road.policy) == []


async def test_an_explanation_tells_who_doubted_and_whether_it_counts(road: Any, reports: Any) -> None:
    rng = random.Random(4)
    for number in range(4):
        await road.report(f"car-{number}", *in_the_roadworks(reports, 2.0 * number, rng), trusted=False)
    await road.report("sure", reports.missed(GONE[0], hours=9.0))
    await road.report("lost", reports.seen(GONE[0], hours=10.0), trusted=False)
    await road.fuse()
    [change] = [one for one in await road.changes() if one.document["map_object_id"] == GONE[0]]
    async with road.engine.connect() as connection:
        stored = await service.find_change(connection, ALL_MAPS, change.id)
        told = await service.explain_change(connection, stored, TimesTold(), reports.at(12.0))
    parts = told["evidence"]["contributions"]
    assert [one["in_doubt"] for one in parts] == [True] * 4 + [False, True]
    assert [one["folds"] for one in parts] == [True] * 5 + [False]
    assert len(told["evidence"]["course"]) == 5
    assert told["evidence"]["policy"]["contributors_in_doubt"] == 4


@dataclass(frozen=True)
class Message:
    car: str
    session: str
    trusted: bool
    passes: tuple[PassReport, ...]


def a_doubtful_fleet(reports: Any, seed: int) -> list[Message]:
    """Cars of which half doubt; some are lost. They come for three days, more often than a window holds."""
    rng = random.Random(seed)
    messages = []
    for number in range(60):
        hours, doubts = rng.uniform(0.0, 72.0), rng.random() < 0.5
        if doubts and rng.random() < 0.2:
            passes = lost(reports, hours, rng)
        else:
            passes = rng.sample(in_the_roadworks(reports, hours, rng), 4)
            passes += [
                (reports.missed if rng.random() < 0.1 else reports.seen)(
                    sign, hours=hours, weight=rng.uniform(0.2, 4.0)
                )
                for sign in rng.sample(STAYS, 2)
            ]
            if rng.random() < 0.1:
                passes.append(reports.seen(rng.choice(GONE), hours=hours + 0.1))
            if rng.random() < 0.2:
                passes.append(reports.find_missed(*NEW, hours=hours))
        messages.append(Message(f"car-{rng.randrange(9)}", f"drive-{number}", not doubts, tuple(passes)))
    return messages


async def believed(road: Any) -> tuple[list[Any], set[Any]]:
    """What is believed, named by what was reported and not by the ids that the database gave."""
    names = (
        "weight_for, weight_against, standing, contributors_for, contributors_against, passes, last_seen, last_looked"
    )
    features = [
        [row[0], *(round(value, 9) if isinstance(value, float) else value for value in row[1:])]
        for row in await road.rows(
            f"SELECT f.object_id, {names} FROM feature_states s JOIN features f ON f.id = s.feature_id ORDER BY 1"
        )
    ]
    candidates = set()
    for row in await road.candidates():
        members = await road.rows(
            """SELECT m.session_id, p.index_in_message FROM passes p JOIN messages m ON m.id = p.message
            WHERE p.candidate_id = :id""",
            id=row.id,
        )
        numbers = (row.sign, row.standing, row.first_seen, *(round(w, 9) for w in (row.weight_for, row.weight_against)))
        candidates.add((frozenset(map(tuple, members)), numbers, row.pair_kind))
    return features, candidates


@pytest.mark.parametrize("seed", [1, 2])
async def test_doubt_is_heard_alike_in_any_order_batch_and_by_any_workers(
    engine: Any, town: Any, reports: Any, seed: int
) -> None:
    policy = Policy(ClassPolicy(window=12, contributors_in_doubt=3))
    road = type(town)(engine, source="road", policy=policy)
    await road.import_map(SIGNS)
    messages, rng, wanted = a_doubtful_fleet(reports, seed), random.Random(seed), None
    for workers, batch_size in ((1, 64), (1, 1), (3, 4)):
        await road.do("TRUNCATE messages, passes, candidates, feature_states, changes, change_entries CASCADE")
        for one in rng.sample(messages, len(messages)):
            for _ in range(rng.choice((1, 1, 2))):
                await road.report(one.car, *one.passes, session=one.session, message_id=1, trusted=one.trusted)
        await asyncio.gather(*(drain(engine, policy, batch_size) for _ in range(workers)))
        result = await believed(road)
        wanted = wanted or result
        assert result == wanted
        assert await rebuild.differences(engine, policy) == []
    deaf = Policy(ClassPolicy(window=12, contributors_in_doubt=0))
    assert len(await rebuild.differences(engine, deaf)) > 5, "doubt was heard"
    assert await road.scalar("SELECT count(*) FROM passes") < sum(len(one.passes) for one in messages)
