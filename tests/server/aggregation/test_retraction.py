"""What is taken out is as if it had never been reported, exactly, whatever happens meanwhile; and it can come back."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any

import pytest

from slamcu_core.aggregation import Policy
from slamcu_core.reports import PassReport
from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.worker import forget_archived
from slamcu_server.retraction import corrections, marks, repository
from slamcu_server.retraction.filter import EvidenceFilter

pytestmark = pytest.mark.anyio


@pytest.fixture
def policy(reports: Any) -> Any:
    """Cars that are no strangers: what is told here is not about them."""
    return reports.KNOWN


SIGNS = tuple((150.0 * number, 0.0) for number in range(5))


@dataclass(frozen=True)
class Message:
    car: str
    session: str
    number: int
    hours: float
    software: str
    passes: tuple[PassReport, ...]


def a_fleet(reports: Any, seed: int) -> list[Message]:
    """Two days of ten cars on one road: mapped signs seen and missed, new ones found that stand close together."""
    rng = random.Random(seed)
    there = [(150.0 * number + 40.0 + shift, 6.0) for number in range(5) for shift in (0.0, 2.4)]
    messages = []
    for number in range(30):
        hours = rng.uniform(0.0, 48.0)
        passes = [
            (reports.missed if rng.random() < 0.5 else reports.seen)(one, hours=hours, weight=rng.uniform(0.0, 4.0))
            for one in rng.sample(range(1, 6), 3)
        ]
        passes += [
            reports.find(x + rng.gauss(0.0, 0.5), y + rng.gauss(0.0, 0.5), hours=hours, weight=rng.uniform(0.5, 4.0))
            for x, y in rng.sample(there, 4)
        ]
        car = f"car-{rng.randrange(10)}"
        messages.append(Message(car, f"s-{number}", 1, hours, rng.choice(("4.1", "4.2")), tuple(passes)))
    return messages


async def tell(road: Any, messages: Iterable[Message]) -> None:
    for one in messages:
        await road.report(
            one.car,
            *one.passes,
            session=one.session,
            message_id=one.number,
            fleet_id="north",
            software_version=one.software,
        )


async def retract(road: Any, **names: Any) -> int:
    async with road.engine.begin() as connection:
        await marks.hold_alone(connection)
        return await repository.add(connection, EvidenceFilter(**names), "a test", None)


async def undo(road: Any, retraction_id: int) -> None:
    async with road.engine.begin() as connection:
        await marks.hold_alone(connection)
        await repository.request_undo(connection, retraction_id, "a test", None)


async def apply(road: Any) -> None:
    await corrections.correct_all(road.engine, road.policy)


async def believed(road: Any) -> dict[Any, dict[str, Any]]:
    """What is believed and said, named by what was reported and not by the ids that the database gave."""
    numbers = ("weight_for", "weight_against", "standing", "contributors_for", "contributors_against", "passes")
    found: dict[Any, dict[str, Any]] = {}
    for row in await road.rows(
        """SELECT f.object_id, s.* FROM feature_states s JOIN features f ON f.id = s.feature_id WHERE s.passes > 0"""
    ):
        found[row.object_id] = {name: getattr(row, name) for name in (*numbers, "last_seen", "last_looked")}
    for row in await road.candidates():
        members = await road.rows(
            """SELECT a.label, m.session_id, p.index_in_message FROM passes p JOIN messages m ON m.id = p.message
            JOIN accounts a ON a.id = p.contributor_id WHERE p.candidate_id = :id""",
            id=row.id,
        )
        key = frozenset((member.label, member.session_id, member.index_in_message) for member in members)
        assert key
        place = {name: getattr(row, name) for name in ("cov_xx", "cov_xy", "cov_yy")}
        found[key] = place | {name: getattr(row, name) for name in (*numbers, "last_seen", "last_looked")}
    return found


def assert_equal(first: dict[Any, Any], second: dict[Any, Any]) -> None:
    assert first.keys() == second.keys()
    for key, numbers in first.items():
        for name, number in numbers.items():
            exact = not isinstance(number, float)
            assert number == (second[key][name] if exact else pytest.approx(second[key][name], abs=1e-9, rel=1e-9))


async def assert_consistent(road: Any) -> None:
    """Beliefs are the fold of what counts, the feed has no gap, and every open change says what is believed."""
    assert await rebuild.differences(road.engine, road.policy) == []
    sequences = [entry.sequence for entry in await road.entries()]
    assert sequences == list(range(1, len(sequences) + 1))
    wrong = await road.rows(
        """SELECT c.id, c.kind, c.state FROM changes c
        LEFT JOIN feature_states s ON c.kind = 'deleted' AND s.feature_id = c.feature_id
        LEFT JOIN candidates k ON c.kind = 'new' AND k.id = c.candidate_id AND k.merged_into IS NULL
        WHERE c.kind IN ('new', 'deleted')
          AND (c.state = 'confirmed') <> COALESCE(s.standing, k.standing, false)"""
    )
    assert wrong == []


async def assert_applied_and_undone(
    road: Any, retraction: int, *, without: dict[Any, Any], whole: dict[Any, Any]
) -> None:
    """The only retraction is applied, to the state without what it names; undone, the whole is back."""
    assert await road.scalar("SELECT state FROM retractions") == "applied"
    assert_equal(await believed(road), without)
    await assert_consistent(road)
    assert await rebuild.rebuild(road.engine, road.policy) == 0

    await undo(road, retraction)
    await apply(road)
    assert await road.scalar("SELECT state FROM retractions") == "undone"
    assert_equal(await believed(road), whole)
    await assert_consistent(road)


@pytest.fixture
async def road(engine: Any, town: Any) -> Any:
    made = type(town)(engine, town.policy, source="road")
    await made.import_map(SIGNS)
    return made


async def clear(road: Any) -> None:
    await road.do(
        """TRUNCATE messages, passes, candidates, feature_states, changes, change_entries, retractions, corrections
        RESTART IDENTITY CASCADE"""
    )
    await road.do("UPDATE feed_position SET last_sequence = 0")


async def test_what_is_taken_out_was_never_there_and_comes_back_whole(road: Any, reports: Any) -> None:
    messages = a_fleet(reports, 1)
    rng = random.Random(1)
    worst = max({one.car for one in messages}, key=lambda car: sum(one.car == car for one in messages))
    await tell(road, messages)
    late = Message(worst, "late", 1, 30.0, "4.2", (reports.missed(1, hours=30.0), reports.find(40.0, 6.0, hours=30.0)))
    everything = [*messages, late]
    await tell(road, [late])
    await road.fuse()
    whole = await believed(road)
    cases: list[tuple[dict[str, Any], Callable[[Message], bool]]] = [
        ({"contributor_id": await road.account(worst)}, lambda one: one.car == worst),
        (
            {
                "fleet_id": "north",
                "software_version": "4.2",
                "event_from": reports.at(12.0),
                "event_until": reports.at(36.0),
            },
            lambda one: one.software == "4.2" and 12.0 <= one.hours < 36.0,
        ),
    ]
    for names, named in cases:
        await clear(road)
        await tell(road, [one for one in everything if not named(one)])
        await road.fuse()
        without = await believed(road)
        assert without != whole

        await clear(road)
        await tell(road, rng.sample(messages, len(messages)))
        await road.fuse()
        retraction = await retract(road, **names)
        await tell(road, [late])
        await corrections.correct(road.engine, road.policy, 15)
        for _ in range(2):  # stopped in the middle, and gone on with by others, while reports come in
            await corrections.correct(road.engine, road.policy, 15)
            await assert_consistent(road)
        await asyncio.gather(apply(road), apply(road), road.fuse_some(1))
        await apply(road)
        await assert_applied_and_undone(road, retraction, without=without, whole=whole)


_HALF_WAY = """
    SELECT (SELECT count(*) FROM passes WHERE retraction_id IS NOT NULL) AS marked,
           (SELECT count(*) FROM corrections) AS listed,
           (SELECT count(*) FROM corrections l JOIN passes p ON p.id = l.pass_id
            WHERE p.retraction_id IS NOT NULL) AS both,
           (SELECT count(*) FROM pg_stat_activity
            WHERE datname = current_database() AND wait_event = 'PgSleep') AS asleep"""


@pytest.mark.parametrize("policy", [Policy()])  # the worker's own
async def test_a_worker_killed_in_the_middle_of_a_retraction_leaves_nothing_half_done(
    road: Any, reports: Any, worker: Callable[[], Any]
) -> None:
    messages = [replace(one, session=f"{seed}-{one.session}") for seed in range(3) for one in a_fleet(reports, seed)]
    named = sum(len(one.passes) for one in messages if one.software == "4.2")
    assert corrections.PIECE < named <= 2 * corrections.PIECE
    await tell(road, [one for one in messages if one.software != "4.2"])
    await road.fuse()
    without = await believed(road)
    await clear(road)
    await tell(road, messages)
    await road.fuse()
    whole = await believed(road)
    # Every piece takes a while after it has marked its passes, so that a kill comes before its commit.
    await road.do(
        """CREATE FUNCTION linger() RETURNS trigger LANGUAGE plpgsql AS
        $$ BEGIN PERFORM pg_sleep(0.8); RETURN NULL; END $$"""
    )
    await road.do(
        """CREATE TRIGGER linger AFTER UPDATE OF retraction_id ON passes
        FOR EACH STATEMENT EXECUTE FUNCTION linger()"""
    )

    async def until(*, asleep: bool, beyond: int = -1) -> Any:
        """Wait until a transaction lingers, or none does, and more passes than so many are marked for good."""
        async with asyncio.timeout(60):
            while True:
                (row,) = await road.rows(_HALF_WAY)
                if (row.asleep > 0) is asleep and row.marked > beyond:
                    return row
                await asyncio.sleep(0.02)

    retraction = await retract(road, software_version="4.2")
    for marked in (0, corrections.PIECE):  # by the first piece, and by the second
        with worker():
            await until(asleep=True, beyond=marked - 1)
        left = await until(asleep=False)  # the database has taken back what the dead had begun
        assert (left.marked, left.listed, left.both) == (marked, named - marked, 0)
        await assert_consistent(road)
    await road.do("DROP TRIGGER linger ON passes")
    await apply(road)
    await assert_applied_and_undone(road, retraction, without=without, whole=whole)


async def test_overlapping_retractions_hold_each_for_itself(road: Any, reports: Any) -> None:
    await tell(road, a_fleet(reports, 3))
    await road.fuse()
    whole = await believed(road)
    one = await retract(road, software_version="4.2")
    two = await retract(road, event_until=reports.at(24.0))
    await apply(road)
    both = await believed(road)
    await undo(road, one)
    await apply(road)
    await undo(road, two)
    await retract(road, software_version="4.2")
    await apply(road)
    await retract(road, event_until=reports.at(24.0))
    await apply(road)
    assert_equal(await believed(road), both)
    for (left,) in await road.rows("SELECT id FROM retractions WHERE state = 'applied'"):
        await undo(road, left)
    await apply(road)
    assert_equal(await believed(road), whole)
    await assert_consistent(road)


async def test_a_confirmed_change_is_withdrawn_in_the_feed_and_confirmed_again(road: Any, reports: Any) -> None:
    for hours, car in enumerate(("liar-1", "liar-2", "liar-3", "liar-4")):
        await road.report(car, reports.missed(1, hours=hours), reports.find(40.0, 9.0, hours=hours), fleet_id="liars")
    await road.report("honest", reports.seen(1, hours=5.0), reports.seen(2, hours=5.0))
    await road.fuse()
    before = {change.id: change.state for change in await road.changes()}
    assert sorted(before.values()) == ["confirmed", "confirmed"]
    retraction = await retract(road, fleet_id="liars")
    await apply(road)
    gone = await road.changes()
    assert [change.state for change in gone] == ["withdrawn", "withdrawn"]
    assert [change.document["withdrawn_because"] for change in gone] == ["retracted", "retracted"]
    assert await road.candidates() == []
    assert (await road.feature_state(1)).contributors_against == 0
    await assert_consistent(road)
    await undo(road, retraction)
    await apply(road)
    assert {change.id: change.state for change in await road.changes()} == before
    await assert_consistent(road)


async def test_a_candidate_lives_on_without_its_founder(road: Any, reports: Any) -> None:
    """Others saw it: by a find of their own, or only because the service told them to look."""
    await road.report("liar", reports.find(40.0, 9.0, hours=0.0), reports.find(240.0, 9.0, hours=0.0))
    await road.fuse()
    first, second = (row.id for row in await road.candidates())
    await road.report("finder", reports.find(40.3, 9.0, hours=1.0))
    for hours, car in enumerate(("one", "two"), 2):
        seen = [reports.seen(key, hours=hours, watched=True) for key in (first, second)]
        where = [reports.place(40.1, 9.1), reports.place(240.1, 9.1)]
        await road.report(car, *(_at(one, place) for one, place in zip(seen, where, strict=True)))
    await road.fuse()
    retraction = await retract(road, contributor_id=await road.account("liar"))
    await apply(road)
    left = await road.candidates()
    assert [(row.id, row.passes, row.standing) for row in left] == [(first, 3, True), (second, 2, True)]
    await assert_consistent(road)
    await road.report("three", reports.missed(second, hours=5.0, watched=True))
    await road.fuse()
    assert (await road.candidates())[1].passes == 3
    await undo(road, retraction)
    await apply(road)
    assert [row.passes for row in await road.candidates()] == [4, 4]
    await assert_consistent(road)


async def test_a_late_report_that_is_taken_out_leaves_nothing_to_fold(road: Any, reports: Any) -> None:
    await retract(road, contributor_id=await road.account("liar"))
    await road.report("liar", reports.missed(3, hours=0.0))
    await road.fuse()
    await assert_consistent(road)
    assert await rebuild.rebuild(road.engine, road.policy) == 0
    assert await road.feature_state(3) is None


async def test_an_heir_is_folded_where_it_saw_the_candidate(road: Any, reports: Any) -> None:
    """Who was told where to look may say to have seen it elsewhere, where another one is."""
    await road.report("liar", reports.find(40.0, 9.0, hours=0.0))
    await road.report("finder", reports.find(240.5, 9.0, hours=1.0))
    await road.fuse()
    lost, other = (row.id for row in await road.candidates())
    await road.report("lost", _at(reports.seen(lost, hours=2.0, watched=True), reports.place(240.0, 9.0)))
    await road.fuse()
    await retract(road, contributor_id=await road.account("liar"))
    await apply(road)
    assert [(row.id, row.passes) for row in await road.candidates()] == [(lost, 2)]
    assert await road.scalar("SELECT merged_into FROM candidates WHERE id = :id", id=other) == lost
    await assert_consistent(road)


def _at(seen: PassReport, where: Any) -> PassReport:
    return replace(seen, sign="STOP_SIGN", position=where)


@pytest.mark.parametrize("order", [("told", "out"), ("out", "told"), ("out", "told too early")])
async def test_who_saw_it_before_or_after_the_founder_was_taken_out_does_not_matter(
    road: Any, reports: Any, order: tuple[str, str]
) -> None:
    """A report that names what was dissolved, from the log or back from a retraction of its own, finds it anew."""
    await road.report("liar", reports.find(40.0, 9.0, hours=0.0))
    await road.fuse()
    [candidate] = await road.candidates()
    for step in order:
        if step == "out":
            await retract(road, contributor_id=await road.account("liar"))
            await apply(road)
            continue
        early = await retract(road, contributor_id=await road.account("one")) if step == "told too early" else None
        for hours, car in ((1.0, "one"), (2.0, "two")):
            say = reports.seen if car == "one" else reports.missed
            await road.report(car, _at(say(candidate.id, hours=hours, watched=True), reports.place(40.3, 9.2)))
        await road.fuse()
        if early is not None:
            await apply(road)
            assert await road.candidates() == []
            await undo(road, early)
            await apply(road)
    [left] = await road.candidates()
    assert (left.id, left.passes, left.contributors_for) == (candidate.id, 2, 1)
    await assert_consistent(road)
    assert await rebuild.rebuild(road.engine, road.policy) == 0
    [out] = await road.rows("SELECT id FROM retractions WHERE state = 'applied'")
    await undo(road, out.id)
    await apply(road)
    [whole] = await road.candidates()
    assert (whole.id, whole.passes, whole.contributors_for) == (candidate.id, 3, 2)
    await assert_consistent(road)


async def test_of_a_moved_sign_the_half_stays_that_is_left(road: Any, reports: Any) -> None:
    for hours in range(4):
        await road.report(f"honest-{hours}", reports.missed(2, hours=float(hours)))
        await road.report(
            f"liar-{hours}", reports.find(150.0, 7.0, hours=hours + 0.5, sign="SPEED_LIMIT"), fleet_id="x"
        )
    await road.fuse()
    assert [(change.kind, change.state) for change in await road.changes()][-1] == ("moved", "confirmed")
    retraction = await retract(road, fleet_id="x")
    await apply(road)
    said = {change.kind for change in await road.changes() if change.state == "confirmed"}
    assert said == {"deleted"}
    assert await road.candidates() == []
    assert await rebuild.differences(road.engine, road.policy) == []
    await undo(road, retraction)
    await apply(road)
    assert {change.kind for change in await road.changes() if change.state == "confirmed"} == {"moved"}
    assert await rebuild.differences(road.engine, road.policy) == []


async def test_a_watch_report_about_what_was_dissolved_does_no_harm(road: Any, reports: Any) -> None:
    await road.report("liar", reports.find(40.0, 9.0, hours=0.0))
    await road.fuse()
    (candidate,) = await road.candidates()
    retraction = await retract(road, contributor_id=await road.account("liar"))
    await apply(road)
    await road.report("honest", reports.missed(candidate.id, hours=1.0, watched=True))
    await road.fuse()
    assert await road.candidates() == []
    await assert_consistent(road)
    await undo(road, retraction)
    await apply(road)
    (again,) = await road.candidates()
    assert (again.id, again.passes) == (candidate.id, 2)
    await assert_consistent(road)


async def test_what_was_taken_out_is_forgotten_in_time_but_not_what_ids_are_bound_to(road: Any, reports: Any) -> None:
    await road.report("liar", reports.missed(1, hours=0.0), reports.find(40.0, 9.0, hours=0.0))
    await road.report("honest", reports.seen(1, hours=0.0))
    await road.fuse()
    await retract(road, contributor_id=await road.account("liar"))
    await apply(road)
    assert await forget_archived(road.engine, timedelta(days=1)) == 0
    assert await forget_archived(road.engine, timedelta(0)) == 1
    assert await road.scalar("SELECT count(*) FROM passes") == 2
    await assert_consistent(road)
