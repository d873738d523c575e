"""Kinds of change: what moved or says something else is one change, from the first doubt to the next map version."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import httpx
import pytest

from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.worker import forget_archived

pytestmark = pytest.mark.anyio


@pytest.fixture
def policy(reports: Any) -> Any:
    """Cars that are no strangers: what is told here is not about them."""
    return reports.KNOWN


Headers = dict[str, str]


async def drive(town: Any, reports: Any, car: str, hours: float, *finds: Any, missed: bool = True) -> None:
    """A car passes: it misses the mapped sign, if told so, and finds what it finds."""
    passes = [reports.missed(1, hours=hours)] if missed else []
    await town.report(car, *passes, *finds)
    await town.fuse()


async def moved(town: Any, reports: Any, cars: int = 5, first: int = 0) -> None:
    for number in range(first, first + cars):
        await drive(town, reports, f"car-{number}", number, reports.find(3, 0, hours=number, sign="SPEED_LIMIT"))


async def modified(town: Any, reports: Any, cars: int = 5) -> None:
    for number in range(cars):
        await drive(town, reports, f"car-{number}", number, reports.find(0.3, 0, hours=number, value="2"))


async def told(town: Any) -> list[tuple[int, str, str]]:
    return [(entry.change_id, entry.kind, entry.state) for entry in await town.entries()]


async def review(client: httpx.AsyncClient, provider: Headers, change_id: int, **body: Any) -> Any:
    etag = (await client.get(f"/v1/changes/{change_id}", headers=provider)).headers["etag"]
    answer = await client.post(f"/v1/changes/{change_id}/review", json=body, headers=provider | {"If-Match": etag})
    assert answer.status_code == 200, answer.text
    return answer.json()


async def test_a_sign_moved_by_three_metres_is_one_change(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await moved(town, reports)
    entries = await told(town)
    assert {change for change, *_ in entries} == {1}
    assert ("new", "confirmed") not in {entry[1:] for entry in entries}  # the new half waits for the other
    assert entries[-1] == (1, "moved", "confirmed")
    change = (await client.get("/v1/changes/1", headers=provider)).json()
    assert change["map_object_id"] == 1
    assert change["from"]["geometry"]["coordinates"] == pytest.approx([2.1, 48.9], abs=1e-9)
    there = reports.place(3, 0)
    assert change["geometry"]["coordinates"] == pytest.approx([there.lon, there.lat], abs=1e-7)
    assert change["to"]["geometry"] == change["geometry"]
    assert (change["from"]["sign"], change["to"]["sign"]) == ("SPEED_LIMIT", "SPEED_LIMIT")
    assert change["from"]["mass_not_exists"] > 0.8
    assert change["mass_exists"] > 0.8
    assert change["evidence"]["would_flip"]["by"] == "misses"
    assert change["evidence_from"]["would_flip"]["by"] == "detections"
    assert len(change["evidence"]["contributions"]) == len(change["evidence_from"]["contributions"]) == 5
    page = (await client.get("/v1/maps/town/features?watch=true", headers=provider)).json()
    [watch] = [one["properties"] for one in page["features"] if one["properties"].get("watch")]
    assert (watch["kind"], watch["replaces"]) == ("moved", 1)
    assert await rebuild.differences(town.engine, town.policy) == []


async def test_what_one_car_finds_vaguely_beside_it_does_not_take_the_old_place_from_a_sign_that_moved(
    town: Any, reports: Any
) -> None:
    await moved(town, reports)
    await drive(town, reports, "car-9", 9, reports.find(-8, 0, hours=9, sign="SPEED_LIMIT", std_m=4.0))
    now = {change: (kind, state) for change, kind, state in await told(town)}
    assert now == {1: ("moved", "confirmed"), 2: ("new", "candidate")}
    assert await rebuild.differences(town.engine, town.policy) == []


async def test_a_sign_that_says_something_else_is_modified(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await modified(town, reports)
    entries = await told(town)
    assert entries[-1] == (1, "modified", "confirmed")
    assert {change for change, *_ in entries} == {1}
    change = (await client.get("/v1/changes/1", headers=provider)).json()
    assert (change["from"]["sign"], change["from"]["value"]) == ("SPEED_LIMIT", None)
    assert (change["sign"], change["value"]) == ("STOP_SIGN", "2")
    assert change["geometry"]["coordinates"] == pytest.approx([2.1, 48.9], abs=1e-9)  # as surveyed


async def test_a_deletion_does_not_wait_and_becomes_the_move_that_it_is(town: Any, reports: Any) -> None:
    for number in range(4):
        await drive(town, reports, f"early-{number}", number)
    assert (await told(town))[-1] == (1, "deleted", "confirmed")
    await drive(town, reports, "a", 5, reports.find(6, 2, hours=5, sign="SPEED_LIMIT"), missed=False)
    assert (await told(town))[-1] == (1, "deleted", "confirmed")
    await drive(town, reports, "b", 6, reports.find(6, 2, hours=6, sign="SPEED_LIMIT"), missed=False)
    assert (await told(town))[-1] == (1, "moved", "confirmed")
    assert {change for change, *_ in await told(town)} == {1}


async def test_a_disputed_find_still_says_what_became_of_a_sign_that_is_gone(town: Any, reports: Any) -> None:
    await moved(town, reports, cars=4)
    assert (await told(town))[-1] == (1, "moved", "confirmed")
    [new] = await town.candidates()
    for number in range(3):
        await drive(town, reports, f"c-{number}", 7 + number, reports.missed(new.id, hours=7 + number, watched=True))
    [new] = await town.candidates()
    assert not new.standing
    assert (await told(town))[-1] == (1, "deleted", "confirmed")
    await drive(town, reports, "e", 10, reports.seen(new.id, hours=10, watched=True))
    [new] = await town.candidates()
    assert not new.standing
    assert (await told(town))[-1] == (1, "moved", "confirmed")
    assert {change for change, *_ in await told(town)} == {1}
    assert await rebuild.differences(town.engine, town.policy) == []


async def test_a_new_sign_waits_for_the_other_half_only_so_long(town: Any, reports: Any) -> None:
    await drive(town, reports, "doubt-0", 0)
    await drive(town, reports, "doubt-1", 0.1)
    for number in range(town.policy.default.pair_patience):
        assert ("new", "confirmed") not in {entry[1:] for entry in await told(town)}
        find = reports.find(8, 0, hours=1 + number, sign="SPEED_LIMIT")
        await drive(town, reports, f"car-{number}", 1 + number, find, missed=False)
    assert (await told(town))[-1][1:] == ("new", "confirmed")


async def test_what_stands_in_the_place_of_a_sign_in_doubt_is_no_second_one(town: Any, reports: Any) -> None:
    await drive(town, reports, "doubt-0", 0)
    await drive(town, reports, "doubt-1", 0.1)
    hours = range(1, town.policy.default.pair_patience + 4)
    for number in hours:
        find = reports.find(3, 0, hours=number, sign="SPEED_LIMIT")
        await drive(town, reports, f"car-{number}", number, find, missed=False)
    assert [(row.kind, row.state) for row in await town.changes()] == [("moved", "candidate")]
    for number in range(2):
        await drive(town, reports, f"sure-{number}", hours[-1] + 1 + number)
    assert [(row.kind, row.state) for row in await town.changes()] == [("moved", "confirmed")]
    assert await rebuild.differences(town.engine, town.policy) == []


async def test_what_stands_in_the_place_of_a_sign_that_some_deny_waits(town: Any, reports: Any) -> None:
    await drive(town, reports, "doubt-0", 0)
    await drive(town, reports, "doubt-1", 1)
    await drive(town, reports, "sure-0", 2, reports.seen(1, hours=2), missed=False)
    for number in range(3, 6):
        find = reports.find(2, 0, hours=number, sign="SPEED_LIMIT")
        await drive(town, reports, f"car-{number}", number, find, missed=False)
    assert [(row.kind, row.state) for row in await town.changes()] == [("moved", "candidate")]
    assert await rebuild.differences(town.engine, town.policy) == []
    for number in range(6, 8):
        await drive(town, reports, f"sure-{number}", number, reports.seen(1, hours=number), missed=False)
    assert ("new", "confirmed") in {(row.kind, row.state) for row in await town.changes()}
    assert await rebuild.differences(town.engine, town.policy) == []


async def test_two_changes_that_turn_out_to_be_one_are_joined_into_the_older(town: Any, reports: Any) -> None:
    for number in range(4):
        await drive(town, reports, f"a-{number}", number)
    for number in range(2):  # nobody can tell yet what the new one is
        find = reports.find(8, 0, hours=5 + number, sign=None)
        await drive(town, reports, f"b-{number}", 5 + number, find, missed=False)
    assert [(row.kind, row.state) for row in await town.changes()] == [("deleted", "confirmed"), ("new", "confirmed")]
    await drive(town, reports, "c", 8, reports.find(8, 0, hours=8, sign="SPEED_LIMIT"), missed=False)
    kept, joined = await town.changes()
    assert (kept.kind, kept.state) == ("moved", "confirmed")
    assert (joined.state, joined.document["withdrawn_because"]) == ("withdrawn", "joined")
    assert joined.document["joined_into"] == kept.id


async def test_a_new_sign_that_was_confirmed_becomes_the_move_that_it_is(town: Any, reports: Any) -> None:
    for number in range(2):
        await drive(
            town, reports, f"a-{number}", number, reports.find(3, 0, hours=number, sign="SPEED_LIMIT"), missed=False
        )
    assert await told(town) == [(1, "new", "candidate"), (1, "new", "confirmed")]
    for number in range(4):
        await drive(town, reports, f"b-{number}", 3 + number)
    entries = await told(town)
    assert entries[-1] == (1, "moved", "confirmed")
    assert {change for change, *_ in entries} == {1}


async def test_a_covered_sign_is_none_of_the_kinds(town: Any, reports: Any) -> None:
    from dataclasses import replace

    for number in range(6):
        covered = replace(reports.seen(1, hours=number), valid=False)
        await town.report(f"car-{number}", covered, reports.find(0.2, 0, hours=number, valid=False))
    await town.fuse()
    assert await told(town) == []
    assert await town.candidates() == []


async def test_one_car_alone_does_not_withdraw_what_others_confirmed(town: Any, reports: Any) -> None:
    for number in range(6):
        await drive(town, reports, f"car-{number}", number)
    assert (await told(town))[-1] == (1, "deleted", "confirmed")
    for number in range(6):
        await town.report("back", reports.seen(1, hours=10 + number))
        await town.fuse()
    assert (await town.changes())[0].state == "confirmed"
    await town.report("also", reports.seen(1, hours=20))
    await town.fuse()
    assert (await town.changes())[0].state == "withdrawn"
    assert (await town.changes())[0].document["withdrawn_because"] == "evidence"


async def test_a_move_whose_old_sign_is_back_is_a_new_sign(town: Any, reports: Any) -> None:
    await moved(town, reports)
    [candidate] = await town.candidates()
    for number in range(5):
        await town.report(
            f"later-{number}",
            reports.seen(1, hours=10 + number),
            reports.seen(candidate.id, hours=10 + number, watched=True),
        )
        await town.fuse()
    assert (await told(town))[-1] == (1, "new", "confirmed")
    assert (await town.changes())[0].feature_id is None
    assert {change for change, *_ in await told(town)} == {1}


async def test_accepting_a_move_edits_the_feature_and_archives_what_was_said_of_the_old_place(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await moved(town, reports)
    accepted = await review(client, provider, 1, decision="accept")
    assert (accepted["kind"], accepted["state"], accepted["map_object_id"]) == ("moved", "accepted", 1)
    page = (await client.get("/v1/maps/town/features?watch=true", headers=provider)).json()
    [feature] = page["features"]
    assert feature["id"] == 1
    there = reports.place(3, 0)
    assert feature["geometry"]["coordinates"] == pytest.approx([there.lon, there.lat], abs=1e-7)
    assert (await town.feature_state(1)).passes == 0
    # Who has the old map speaks of the old place when he misses it, and of the new one when he finds it.
    await town.report("old-map", reports.missed(1, hours=20), reports.find(3, 0, hours=20, sign="SPEED_LIMIT"))
    await town.report("new-map", reports.seen(1, hours=21), version="2026.05+1")
    await town.fuse()
    state = await town.feature_state(1)
    assert (state.contributors_for, state.contributors_against) == (2, 0)
    assert await town.candidates() == []
    assert await rebuild.differences(town.engine, town.policy) == []
    explained = (await client.get("/v1/changes/1", headers=provider)).json()
    assert len(explained["evidence_from"]["contributions"]) >= 5
    assert explained["mapped_in"] == "2026.05+1"
    taken = await town.scalar("SELECT mapped_at - first_evidence_at FROM changes")
    assert taken.total_seconds() > 0


async def test_what_no_belief_needs_any_more_is_forgotten_in_time(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await moved(town, reports)
    [candidate] = await town.candidates()
    await review(client, provider, 1, decision="accept")
    assert await forget_archived(town.engine, timedelta(days=1)) == 0
    assert await forget_archived(town.engine, timedelta(0)) == 9
    assert [row.id for row in await town.rows("SELECT id FROM passes")] == [candidate.founding_pass]
    # Vehicles may still name the watch feature that it was.
    await town.report("watcher", reports.seen(candidate.id, hours=30, watched=True))
    await town.fuse()
    assert (await town.feature_state(1)).contributors_for == 1


async def test_accepting_a_modification_keeps_the_place(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await modified(town, reports)
    await review(client, provider, 1, decision="accept")
    [feature] = (await client.get("/v1/maps/town/features?watch=true", headers=provider)).json()["features"]
    assert feature["geometry"]["coordinates"] == pytest.approx([2.1, 48.9], abs=1e-9)
    assert (feature["properties"]["sign"], feature["properties"]["value"]) == ("STOP_SIGN", "2")
    assert feature["properties"]["position_std_m"] == pytest.approx(0.15)
    feature_id = feature["properties"]["feature_id"]
    versions = (await client.get(f"/v1/features/{feature_id}", headers=provider)).json()["versions"]
    assert [version["sign"] for version in versions] == ["SPEED_LIMIT", "STOP_SIGN"]


async def test_a_rejected_move_stays_silent_until_its_evidence_has_left(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await moved(town, reports)
    await review(client, provider, 1, decision="reject", reason="a trailer")
    await moved(town, reports, cars=2, first=8)
    assert (await told(town))[-1] == (1, "moved", "rejected")
    [candidate] = await town.candidates()
    for number in range(6):
        await town.report(
            f"late-{number}",
            reports.seen(1, hours=20 + number),
            reports.missed(candidate.id, hours=20 + number, watched=True),
        )
        await town.fuse()
    assert (await told(town))[-1] == (1, "moved", "rejected")
    await moved(town, reports, cars=6, first=40)
    assert (await told(town))[-1] == (2, "moved", "confirmed")
