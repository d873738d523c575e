"""Trust follows the record, in versions; what they change is folded again, and equals a rebuild."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import httpx
import pytest

from slamcu_server.aggregation import rebuild
from slamcu_server.retraction import corrections, marks, repository
from slamcu_server.retraction.filter import EvidenceFilter
from slamcu_server.trust.job import Recomputed, recompute
from slamcu_server.trust.table import load

pytestmark = pytest.mark.anyio

SIGNS = tuple((150.0 * number, 0.0) for number in range(10))
NOW = datetime(2026, 5, 10, tzinfo=UTC)
LIARS = ("liar-1", "liar-2", "liar-3")


@pytest.fixture
async def road(engine: Any, town: Any) -> Any:
    made = type(town)(engine, source="road")
    await made.import_map(SIGNS)
    return made


async def drive(road: Any, reports: Any, car: str, hours: float, *, lost: bool = False, session: str = "s") -> None:
    """Drive past all signs, and see them; who is lost sees none."""
    say = reports.missed if lost else reports.seen
    await road.report(car, *(say(number, hours=hours) for number in range(1, 11)), session=session)
    await road.fuse()


async def renew(road: Any) -> Recomputed:
    done = await recompute(road.engine, NOW)
    assert done is not None
    await corrections.correct_all(road.engine, road.policy)
    assert await rebuild.differences(road.engine, road.policy) == []
    return done


async def shares(road: Any) -> dict[str, float]:
    rows = await road.rows(
        "SELECT a.label, t.share FROM trust t JOIN accounts a ON a.id = t.contributor_id WHERE to_version IS NULL"
    )
    return {row.label: row.share for row in rows}


async def test_liars_who_came_first_lose_trust_and_what_they_said_falls(road: Any, reports: Any) -> None:
    for round_ in range(2):
        for number, liar in enumerate(LIARS):
            hours = 3 * round_ + number
            await road.report(liar, *(reports.missed(one, hours=hours) for one in range(1, 9)), session=f"{round_}")
    await road.fuse()
    assert {change.state for change in await road.changes()} == {"candidate"}  # three strangers delete nothing
    for number in range(4):
        await drive(road, reports, f"honest-{number}", 10.0 + number)
    first = await renew(road)
    assert first.version == 1
    assert {change.state for change in await road.changes()} == {"withdrawn"}
    known = await shares(road)
    assert all(known[liar] < 0.7 for liar in LIARS)
    assert not any(name.startswith("honest") and share < 1.0 for name, share in known.items())
    assert len(await road.rows("SELECT id FROM retractions WHERE requested_by IS NULL AND state = 'applied'")) == 6

    again = await renew(road)
    assert (again.version, again.changed) == (1, False)
    # now they are known, and come again, hour after hour
    for number in range(12):
        await road.report(LIARS[number % 3], reports.missed(1, hours=20.0 + number), session=f"again-{number}")
    await road.fuse()
    assert (await road.feature_state(1)).standing is False
    assert await rebuild.differences(road.engine, road.policy) == []


async def test_a_lost_car_is_gated_and_let_in_again_when_others_come_to_agree(road: Any, reports: Any) -> None:
    await drive(road, reports, "before", 0.0)
    await drive(road, reports, "lost", 1.0, lost=True, session="lost")
    await drive(road, reports, "lost", 2.0, session="found again")
    for number in range(3):
        await drive(road, reports, f"other-{number}", 3.0 + number)
    done = await renew(road)
    assert done.gated == ((await road.account("lost"), "lost"),)
    assert (await road.feature_state(1)).passes == 5
    late = reports.missed(1, hours=1.1)
    await road.report("lost", late, session="lost", message_id=2)
    await road.fuse()
    assert (await road.feature_state(1)).passes == 5
    # it was not lost: the signs were gone, and the eight that come nearest after it now say so too
    for number in range(8):
        await drive(road, reports, f"later-{number}", 1.2 + 0.05 * number, lost=True)
    released = await renew(road)
    assert released.released == done.gated
    assert (await road.feature_state(1)).passes == 15


async def test_what_honest_cars_have_refuted_takes_new_voices_whatever_order_it_came_in(
    road: Any, reports: Any
) -> None:
    """Three deny a sign, one sees it, one misses it: before any version, with a version, and told backwards."""
    said = [*((liar, True) for liar in LIARS * 2), ("sees", False), ("misses", True), ("again", False)]
    for feature, order in ((1, said), (2, said[::-1])):
        for number, (car, lost) in sorted(enumerate(said), reverse=order != said):
            say = reports.missed if lost else reports.seen
            await road.report(car, say(feature, hours=float(number)), session=f"{number}", message_id=feature)
            await road.fuse()
            assert (await road.feature_state(feature)).standing is False
    await renew(road)
    assert {change.state for change in await road.changes()} <= {"candidate", "withdrawn"}
    for number in range(4):
        await road.report(f"later-{number}", reports.missed(1, hours=20.0 + number))
        await road.fuse()
        assert (await road.feature_state(1)).standing is (number == 3)
    assert await rebuild.differences(road.engine, road.policy) == []


async def test_a_find_by_strangers_waits_for_company_and_no_version_takes_it_back(road: Any, reports: Any) -> None:
    """It takes one more of them than of those who were right about finds, before the first version and after it."""
    places = [(40.0 + 150.0 * number, 9.0) for number in range(3)]
    for number in range(5):
        await road.report(f"old-{number}", *(reports.find(*place, hours=float(number)) for place in places))
        await road.fuse()
        assert {row.standing for row in await road.candidates()} == {number >= 2}
    before = await road.entries()
    await renew(road)
    assert await road.entries() == before
    assert {change.document["trust_version"] for change in await road.changes()} == {0}
    proven = {
        row.label
        for row in await road.rows(
            "SELECT a.label FROM trust t JOIN accounts a ON a.id = t.contributor_id WHERE proven AND to_version IS NULL"
        )
    }
    assert proven == {"old-0", "old-1"}  # three others came after each of these
    strangers, mixed = (640.0, 9.0), (790.0, 9.0)
    for number in range(4):
        await road.report(f"new-{number}", reports.find(*strangers, hours=20.0 + number))
        if number < 1:
            await road.report(f"new-{number}", reports.find(*mixed, hours=20.0 + number))
        await road.fuse()
        standing = [row.standing for row in await road.rows("SELECT standing FROM candidates ORDER BY id")][3:]
        assert standing[0] is (number >= 2)
    await road.report("old-0", reports.find(*mixed, hours=30.0))
    await road.fuse()
    assert [row.standing for row in await road.candidates()] == [True] * 5
    assert (await road.changes())[-1].document["trust_version"] == 1
    assert await rebuild.differences(road.engine, road.policy) == []


async def test_who_was_taken_out_neither_judges_nor_is_judged(road: Any, reports: Any) -> None:
    await drive(road, reports, "victim", 0.0)
    for number in range(4):
        await drive(road, reports, f"broken-{number}", 1.0 + number, lost=True, session="broken")
    async with road.engine.begin() as connection:
        await marks.hold_alone(connection)
        by = await road.account("somebody")
        await repository.add(connection, EvidenceFilter(session_id="broken"), "a test", by)
    await corrections.correct_all(road.engine, road.policy)
    done = await renew(road)
    assert (done.version, done.judged, done.contributors) == (None, 0, {})


async def test_a_version_can_be_had_again(road: Any, reports: Any) -> None:
    await drive(road, reports, "lost", 0.0, lost=True)
    for number in range(4):
        await drive(road, reports, f"other-{number}", 1.0 + number)
    await renew(road)
    async with road.engine.connect() as connection:
        trusts = await load(connection, 1)
    assert trusts.shares([await road.account("lost"), 10**6]).tolist() == [pytest.approx(0.35), 1.0]


async def test_the_command_and_the_explanation(
    road: Any, reports: Any, client: httpx.AsyncClient, provider: Any, command: Callable[..., Any]
) -> None:
    for number in range(3):
        await road.report(f"liar-{number}", *(reports.missed(one, hours=float(number)) for one in range(1, 9)))
    for number in range(5):
        await road.report(f"honest-{number}", *(reports.seen(one, hours=5.0 + number) for one in range(1, 9)))
    await road.report("finder", reports.find(40.0, 9.0, hours=1.0))
    await road.fuse()
    # the reports lie further back than a record reaches
    await road.do(
        "UPDATE passes SET ended_at = ended_at + (now() - '2026-05-02'), started_at = now() - interval '2 day'"
    )
    await rebuild.rebuild(road.engine, road.policy)
    said = await asyncio.to_thread(command, "recompute-trust")
    assert said.returncode == 0, said.stderr
    assert "trust version 1" in said.stderr
    assert len(said.stdout.splitlines()) == 3
    assert all(float(line.split("\t")[1]) < 1.0 for line in said.stdout.splitlines())
    assert await rebuild.differences(road.engine, road.policy) == []
    (change,) = [row for row in await road.changes() if row.kind == "new"]
    shown = await client.get(f"/v1/changes/{change.id}", headers=provider)
    assert shown.status_code == 200
