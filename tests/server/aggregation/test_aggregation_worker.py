"""What becomes of reports: the law of evidence over real passes in a real database."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from slamcu_core.geometry import LocalFrame
from slamcu_server.aggregation import rebuild

pytestmark = pytest.mark.anyio


@pytest.fixture
def policy(reports: Any) -> Any:
    """Cars that are no strangers: what is told here is not about them."""
    return reports.KNOWN


async def test_three_cars_that_miss_a_sign_delete_it(town: Any, reports: Any) -> None:
    for number in range(3):
        await town.report(f"car-{number}", reports.missed(1, hours=number))
    await town.fuse()
    state = await town.feature_state(1)
    assert state.contributors_against == 3
    assert state.looked == 3
    for number in range(3, 6):
        await town.report(f"car-{number}", reports.missed(1, hours=number))
    await town.fuse()
    assert (await town.feature_state(1)).standing
    [change] = await town.changes()
    assert (change.kind, change.state) == ("deleted", "confirmed")
    assert change.document["map_object_id"] == 1


async def test_two_cars_that_see_a_new_sign_confirm_it(town: Any, reports: Any) -> None:
    await town.report("a", reports.find(30, 0, hours=0))
    await town.fuse()
    [change] = await town.changes()
    assert (change.kind, change.state) == ("new", "candidate")
    await town.report("b", reports.find(30.5, 0.2, hours=1))
    await town.fuse()
    [candidate] = await town.candidates()
    assert candidate.standing
    assert candidate.contributors_for == 2
    assert candidate.sign == "STOP_SIGN"
    [change] = await town.changes()
    assert (change.state, change.revision) == ("confirmed", 2)
    assert [entry.sequence for entry in await town.entries()] == [1, 2]


async def test_one_car_never_decides(town: Any, reports: Any) -> None:
    for number in range(100):
        await town.report("liar", reports.find(30, 0, hours=2 * number), reports.missed(1, hours=2 * number))
    await town.fuse()
    [candidate] = await town.candidates()
    assert candidate.contributors_for == 1
    assert not candidate.standing
    assert not (await town.feature_state(1)).standing
    assert {change.state for change in await town.changes()} == {"candidate"}


async def test_what_cannot_count_is_kept_and_counts_nothing(town: Any, reports: Any) -> None:
    for number in range(4):
        await town.report(f"blind-{number}", reports.blocked(1, hours=number))
        if number < 3:  # a fourth who says the same would be heard
            await town.report(
                f"lost-{number}", reports.missed(1, hours=number), reports.find(30, 0, hours=number), trusted=False
            )
        await town.report(f"crossed-{number}", reports.find(60, 0, hours=number, valid=False))
    await town.fuse()
    state = await town.feature_state(1)
    assert (state.weight_against, state.looked, state.blocked) == (0.0, 0, 4)
    [candidate] = await town.candidates()
    assert (candidate.weight_for, candidate.standing, candidate.first_seen) == (0.0, False, None)
    assert await town.changes() == []
    assert await town.scalar("SELECT count(*) FROM passes") == 14


async def test_a_find_that_is_missed_again_counts_against_its_candidate(town: Any, reports: Any) -> None:
    await town.report("a", reports.find(30, 0, hours=0))
    await town.report("b", reports.find_missed(30, 0.5, hours=1), reports.find_missed(300, 0, hours=1))
    await town.fuse()
    [candidate] = await town.candidates()
    assert candidate.weight_against > 0
    assert candidate.contributors_against == 1
    assert await town.scalar("SELECT count(*) FROM passes WHERE candidate_id IS NULL") == 1


async def test_liars_are_unmade_by_cars_that_watch(town: Any, reports: Any) -> None:
    for liar in ("liar-1", "liar-2"):
        await town.report(liar, reports.find(30, 0, hours=0))
    await town.fuse()
    [candidate] = await town.candidates()
    assert candidate.standing
    for number in range(3):
        await town.report(f"honest-{number}", reports.missed(candidate.id, hours=1 + number, watched=True))
    await town.fuse()
    [candidate] = await town.candidates()
    assert not candidate.standing
    assert candidate.contributors_against == 3
    [change] = await town.changes()
    assert change.state == "withdrawn"
    # the evidence turns once more: the same change goes on
    for number in range(4):
        await town.report(f"later-{number}", reports.seen(candidate.id, hours=10 + number, watched=True))
    await town.fuse()
    assert [entry.state for entry in await town.entries()] == ["confirmed", "withdrawn", "confirmed"]
    assert len({entry.change_id for entry in await town.entries()}) == 1


async def test_signs_of_different_kinds_are_different_candidates(town: Any, reports: Any) -> None:
    for car in ("a", "b"):
        await town.report(car, reports.find(30, 0, hours=0), reports.find(30.5, 0, hours=0, sign="YIELD"))
    await town.fuse()
    assert sorted(row.sign for row in await town.candidates()) == ["STOP_SIGN", "YIELD"]


async def test_unreadable_messages_are_put_aside_alone(town: Any, reports: Any) -> None:
    await town.report("a", reports.missed(1, hours=0))
    await town.log("broken", "s", 1, b"\xff\xff no protobuf")
    await town.report("lost", reports.missed(1, hours=0), version="never imported")
    await town.report("dreamer", reports.missed(99, hours=0))
    await town.report("b", reports.missed(1, hours=1))
    await town.fuse()
    rows = await town.rows(
        "SELECT a.label, m.error FROM messages m JOIN accounts a ON a.id = account_id WHERE state = 'quarantined'"
    )
    reasons = {row.label: row.error for row in rows}
    assert reasons.keys() == {"broken", "lost", "dreamer"}
    assert "never imported" in reasons["lost"]
    assert "99" in reasons["dreamer"]
    assert (await town.feature_state(1)).contributors_against == 2


async def test_a_message_that_breaks_the_fold_does_not_hold_up_the_others(town: Any, reports: Any) -> None:
    await town.do("ALTER TABLE passes ADD CONSTRAINT injected CHECK (fleet_id <> '' OR frames_missed <> 7)")
    await town.report("a", reports.missed(1, hours=0))
    bad = reports.missed(1, hours=1)
    await town.report("poison", type(bad)(**{**_fields(bad), "frames_missed": 7}))
    await town.report("b", reports.missed(1, hours=2))
    await town.fuse()
    [row] = await town.rows("SELECT error FROM messages WHERE state = 'quarantined'")
    assert "injected" in row.error
    assert (await town.feature_state(1)).contributors_against == 2


def _fields(report: Any) -> dict[str, Any]:
    return {name: getattr(report, name) for name in report.__dataclass_fields__}


async def test_a_message_from_all_over_the_world_locks_its_whole_map(
    town: Any, reports: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamcu_server.aggregation.locks.CELL_BUDGET", 20)
    monkeypatch.setattr("slamcu_server.aggregation.batch.CELL_BUDGET", 20)
    for car in ("a", "b"):
        await town.report(car, *(reports.find(2000.0 * number, 0, hours=0) for number in range(40)))
        await town.report(car, reports.find(5, 20, hours=0))
    await asyncio.gather(*(town.fuse_some(batch_size=3) for _ in range(2)))
    assert [row.contributors_for for row in await town.candidates()] == [2] * 41


async def test_a_sign_on_the_antimeridian_is_one_sign(town: Any, reports: Any) -> None:
    here = reports.place(0, 0)
    for car, lon in (("a", 179.999995), ("b", -179.999995)):
        position = replace(here, lon=lon, lat=-16.5)
        await town.report(car, reports.find(0, 0, hours=0, position=position))
        await town.fuse()
    [candidate] = await town.candidates()
    assert candidate.contributors_for == 2


@pytest.mark.parametrize(("lon", "lat"), [(180.0, 10.0), (-180.0, 10.0), (180.0, 89.9999), (5.0, -90.0)])
async def test_a_sign_at_the_edge_of_the_coordinates_is_told_within_them(
    town: Any, reports: Any, lon: float, lat: float
) -> None:
    here = replace(reports.place(0, 0), lon=lon, lat=lat)
    for number, car in enumerate("abc"):
        await town.report(car, reports.find(0, 0, hours=number, position=here))
    await town.fuse()
    [told] = [one.document["geometry"]["coordinates"] for one in await town.changes()]
    [[east, north]] = await town.rows("SELECT ST_X(geom), ST_Y(geom) FROM candidates")
    assert told == [east, north]
    assert -180.0 <= east < 180.0
    assert -90.0 <= north <= 90.0
    assert LocalFrame(lon, lat).to_local(east, north) == pytest.approx([0.0, 0.0], abs=1e-6)


async def test_a_sign_whose_place_the_map_knows_exactly_is_told_like_any_other(town: Any, reports: Any) -> None:
    await town.do("UPDATE feature_versions SET position_std_m = 0")
    for number in range(8):
        await town.report(f"car-{number}", reports.missed(1, hours=number))
        await town.fuse()
    assert await town.scalar("SELECT count(*) FROM messages WHERE state = 'fused'") == 8
    [change] = await town.changes()
    assert (change.kind, change.state) == ("deleted", "confirmed")
    assert change.document["covariance_m2"] == [0.0, 0.0, 0.0]


async def test_candidates_are_merged_and_part_again_with_their_ids(town: Any, reports: Any) -> None:
    """What vehicles say about a watch feature follows the pass that founded it."""
    await town.report("a", reports.find(50.0, 0, hours=0, std_m=2.0))
    await town.report("b", reports.find(55.5, 0, hours=0, std_m=2.0))
    await town.fuse()
    first, second = [row.id for row in await town.candidates()]
    await town.report("c", reports.find(52.7, 0, hours=1, std_m=2.0))  # a bridge between two vague places
    await town.report("watcher", reports.seen(second, hours=2, watched=True))
    await town.fuse()
    [whole] = await town.candidates()
    assert (whole.id, whole.passes, whole.contributors_for) == (first, 4, 4)
    assert [change.state for change in await town.changes()] == ["confirmed", "withdrawn"]
    assert (await town.changes())[1].document["merged_into"] == first
    assert await rebuild.differences(town.engine, town.policy) == []

    for car in ("d", "e", "f"):  # precise ones show that there are two
        await town.report(car, reports.find(50.0, 0, hours=3, std_m=0.4), reports.find(55.5, 0, hours=3, std_m=0.4))
    await town.fuse()
    parted = await town.candidates()
    assert [row.id for row in parted] == [first, second]
    about = await town.rows("SELECT candidate_id FROM passes WHERE watch_id = :id", id=second)
    assert [row.candidate_id for row in about] == [second]
    assert [change.state for change in await town.changes()] == ["confirmed", "confirmed"]
    assert await rebuild.differences(town.engine, town.policy) == []
