"""What comes back after the map went on is about the map's sign, if the map has taken it in meanwhile."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import httpx
import pytest

from slamcu_core.aggregation import ClassPolicy, Policy
from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.locks import lock_cells
from slamcu_server.aggregation.refold import cells_of
from slamcu_server.retraction import corrections, marks, repository
from slamcu_server.retraction.filter import EvidenceFilter
from slamcu_server.trust.job import GATE_REASON

pytestmark = pytest.mark.anyio

SIGN = 5
NEXT = {1: (0.0, 0.0), SIGN: (100.2, 0.1, "STOP_SIGN")}


@pytest.fixture
def policy(reports: Any) -> Any:
    """Cars that are no strangers: what is told here is not about them."""
    return reports.KNOWN


@pytest.fixture
def retract(town: Any, client: httpx.AsyncClient, admin: dict[str, str]) -> Any:
    """Take out what a fleet reported, and apply it; return how to undo that, and to apply the undoing."""

    async def run(fleet: str) -> Any:
        asked = {"fleet_id": fleet, "reason": "a test"}
        made = await client.post("/v1/evidence/retract", json=asked, headers=admin)
        assert made.status_code == 202
        await corrections.correct_all(town.engine, town.policy)

        async def undo() -> None:
            url = f"/v1/evidence/retractions/{made.json()['id']}/undo"
            assert (await client.post(url, json={"reason": "a test"}, headers=admin)).status_code == 202
            await corrections.correct_all(town.engine, town.policy)
            assert (await client.get(url.removesuffix("/undo"), headers=admin)).json()["state"] == "undone"

        return undo

    return run


async def assert_settled(town: Any) -> None:
    """What is believed is the fold of what is kept, and folding it again says nothing new."""
    assert await rebuild.differences(town.engine, town.policy) == []
    assert await rebuild.rebuild(town.engine, town.policy) == 0


async def found(town: Any, reports: Any, *cars: str, fleet: str, hours: float = 0.0) -> None:
    for number, car in enumerate(cars):
        await town.report(car, reports.find(100, 0, hours=hours + number), fleet_id=fleet)
    await town.fuse()


async def test_what_the_map_took_in_meanwhile_is_not_found_again(
    *, town: Any, reports: Any, imports: Any, retract: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    await found(town, reports, "a", "b", "c", fleet="vans")
    [candidate] = await town.candidates()
    undo = await retract("vans")
    await town.report("other", reports.missed(candidate.id, hours=4.0, watched=True))
    await town.fuse()
    await imports("2026.06", NEXT)
    await undo()
    await assert_settled(town)

    assert await town.candidates() == []
    state = await town.feature_state(SIGN)
    assert (state.passes, state.looked, state.contributors_for) == (4, 4, 3)
    listed = await client.get("/v1/changes", params={"latest": True}, headers=provider)
    assert [entry["change"]["state"] for entry in listed.json()["entries"]] == ["withdrawn"]
    shown = await client.get("/v1/maps/town/features", params={"watch": True}, headers=provider)
    assert [each["id"] for each in shown.json()["features"]] == [1, SIGN]
    # whoever was told to look for the find looks for the sign
    await town.report("late", reports.seen(candidate.id, hours=5.0, watched=True))
    await town.fuse()
    assert (await town.feature_state(SIGN)).passes == 5
    await assert_settled(town)


async def test_finds_and_watch_reports_come_back_to_a_candidate_that_was_accepted(
    town: Any, reports: Any, retract: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    await found(town, reports, "a", fleet="vans")
    [candidate] = await town.candidates()
    await found(town, reports, "b", "c", "d", fleet="cars", hours=1.0)
    seen = replace(
        reports.seen(candidate.id, hours=4.0, watched=True), sign="STOP_SIGN", position=reports.place(100, 0)
    )
    await town.report("e", seen, fleet_id="vans")
    await town.fuse()
    undo = await retract("vans")
    [change] = await town.changes()
    accepted = await client.post(
        f"/v1/changes/{change.id}/review",
        json={"decision": "accept"},
        headers={
            **provider,
            "If-Match": (await client.get(f"/v1/changes/{change.id}", headers=provider)).headers["ETag"],
        },
    )
    assert accepted.status_code == 200
    await undo()
    await assert_settled(town)
    assert await town.candidates() == []
    state = await town.feature_state(accepted.json()["map_object_id"])
    assert (state.passes, state.contributors_for) == (2, 2)
    assert [(change.kind, change.state) for change in await town.changes()] == [("new", "accepted")]


async def test_a_session_that_the_server_lets_in_again_is_matched_too(town: Any, reports: Any, imports: Any) -> None:
    await found(town, reports, "a", fleet="vans")
    gated = EvidenceFilter(contributor_id=await town.account("a"), session_id="s")
    async with town.engine.begin() as connection:
        await marks.hold_alone(connection)
        gate = await repository.add(connection, gated, GATE_REASON, None)
    await corrections.correct_all(town.engine, town.policy)
    await imports("2026.06", NEXT)
    async with town.engine.begin() as connection:
        await marks.hold_alone(connection)
        assert await repository.list_gates(connection) == {(gated.contributor_id, "s"): gate}
        await repository.request_undo(connection, gate, "others agree", None)
    await corrections.correct_all(town.engine, town.policy)
    assert await town.candidates() == []
    assert (await town.feature_state(SIGN)).passes == 1
    await assert_settled(town)


@pytest.mark.parametrize("policy", [Policy(ClassPolicy(strangers_more=0, window=4))])
async def test_the_id_of_a_find_that_came_back_outlives_it(town: Any, reports: Any, imports: Any, retract: Any) -> None:
    await found(town, reports, "a", fleet="vans")
    [candidate] = await town.candidates()
    undo = await retract("vans")
    await imports("2026.06", NEXT)
    await undo()
    for number in range(8):
        await town.report(f"car-{number}", reports.seen(SIGN, hours=10.0 * (number + 1)), version="2026.06")
    await town.fuse()
    assert await town.scalar("SELECT count(*) FROM passes WHERE id = :id", id=candidate.founding_pass) == 0
    before = (await town.feature_state(SIGN)).looked
    await town.report("late", reports.seen(candidate.id, hours=90.0, watched=True))
    await town.fuse()
    assert await town.scalar("SELECT error FROM messages ORDER BY id DESC LIMIT 1") is None
    state = await town.feature_state(SIGN)
    assert (state.looked + state.forgotten_looked, before) == (10, 4)
    await assert_settled(town)


async def test_a_find_of_a_car_that_knew_the_sign_stays_another(
    town: Any, reports: Any, imports: Any, retract: Any
) -> None:
    await imports("2026.06", NEXT)
    await town.report("a", reports.find(103, 0, hours=0.0), fleet_id="vans", version="2026.06")
    await town.fuse()
    undo = await retract("vans")
    await imports("2026.07", {**NEXT, 6: (300.0, 0.0)})
    await undo()
    await assert_settled(town)
    assert [row.passes for row in await town.candidates()] == [1]
    assert (await town.feature_state(SIGN)) is None


async def test_nothing_is_matched_that_was_not_out(town: Any, reports: Any, imports: Any) -> None:
    """A correction for another reason leaves a find as it was read, or beliefs would hang on what is corrected when."""
    for hours in range(3):
        await town.report(f"a-{hours}", reports.find(100.0, 0.0, hours=float(hours), std_m=0.2))
    await town.report("vague", reports.find(101.5, 0.0, hours=3.0, std_m=1.5))
    await town.fuse()
    [candidate] = await town.candidates()
    await imports("2026.06", {1: (0.0, 0.0), SIGN: (102.4, 0.0, "STOP_SIGN")})
    await town.do("INSERT INTO corrections (pass_id) SELECT id FROM passes")
    await corrections.correct_all(town.engine, town.policy)
    assert [(row.id, row.passes) for row in await town.candidates()] == [(candidate.id, 4)]
    await assert_settled(town)


async def test_the_cells_of_a_sign_that_came_from_elsewhere_are_held(
    town: Any, reports: Any, imports: Any, retract: Any
) -> None:
    await found(town, reports, "a", "b", fleet="vans")
    undo = await retract("vans")
    await imports("2026.06", {1: (0.0, 0.0), SIGN: (2000.0, 0.0, "STOP_SIGN")})
    await imports("2026.07", NEXT)
    first = reports.place(2000.0, 0.0)
    async with town.engine.begin() as connection:
        await lock_cells(connection, cells_of([(town.map_id, first.lon, first.lat)], town.policy))
        undoing = asyncio.create_task(undo())
        done, _ = await asyncio.wait({undoing}, timeout=1.0)
        assert not done
    await undoing
    await assert_settled(town)
    assert (await town.feature_state(SIGN)).passes == 2
    assert await town.candidates() == []


async def test_a_sign_that_the_map_dropped_meanwhile_is_as_if_nothing_had_been_out(
    town: Any, reports: Any, imports: Any, retract: Any
) -> None:
    async def drive(*, out: bool) -> list[Any]:
        version = ("out-" if out else "in-") + "{}"
        await imports(version.format(1), NEXT)
        await town.report("old", reports.find(100, 0, hours=0.0), session=version, fleet_id="vans")
        await town.report("new", reports.missed(SIGN, 1.0), session=version, version=version.format(1), fleet_id="vans")
        await town.fuse()
        undo = await retract("vans") if out else None
        await imports(version.format(2), {1: (0.0, 0.0)})
        if undo is not None:
            await undo()
        await assert_settled(town)
        names = "weight_for, weight_against, standing, contributors_for, contributors_against, passes"
        states = await town.rows(f"SELECT {names} FROM feature_states ORDER BY feature_id")
        return [states, await town.candidates(), [change.state for change in await town.changes()]]

    kept = await drive(out=False)
    await town.do("TRUNCATE messages, passes, feature_states, changes, change_entries CASCADE")
    await town.do("UPDATE feed_position SET last_sequence = 0")
    assert await drive(out=True) == kept
