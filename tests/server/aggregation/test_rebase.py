"""A provider's next map version settles what was open, and evidence follows what has stayed."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import httpx
import pytest

from slamcu_core.errors import SlamcuError
from slamcu_server.changes.rebase import Rebased, Survey

pytestmark = pytest.mark.anyio


async def deleted(town: Any, reports: Any, cars: int = 6) -> None:
    for number in range(cars):
        await town.report(f"car-{number}", reports.missed(1, hours=number))
    await town.fuse()


async def new(town: Any, reports: Any, x: float = 100.0) -> None:
    for car in ("a", "b", "c"):
        await town.report(car, reports.find(x, 0, hours=1))
    await town.fuse()


async def moved(town: Any, reports: Any) -> None:
    for number in range(6):
        find = reports.find(8, 0, hours=number, sign="SPEED_LIMIT")
        await town.report(f"car-{number}", reports.missed(1, hours=number), find)
    await town.fuse()


async def states(town: Any) -> list[tuple[str, str]]:
    return [(change.kind, change.state) for change in await town.changes()]


async def test_what_the_new_version_shows_is_absorbed(
    town: Any, reports: Any, imports: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    await deleted(town, reports)
    await new(town, reports)
    assert await imports("2026.06", {5: (100.3, 0.1, "STOP_SIGN")}) == Rebased(absorbed=2)
    assert await states(town) == [("deleted", "absorbed"), ("new", "absorbed")]
    assert await town.candidates() == []
    change = (await client.get("/v1/changes/2", headers=provider)).json()
    assert (change["map_object_id"], change["mapped_in"]) == (5, "2026.06")
    first, mapped = (datetime.fromisoformat(change[name]) for name in ("first_evidence", "mapped_at"))
    assert first == reports.at(1)
    assert mapped > first
    assert len(change["evidence"]["contributions"]) == 3  # archived, and still there to be asked for
    told = (await client.get("/metrics")).text
    assert 'slamcu_changes{kind="new",state="absorbed"} 1.0' in told
    assert 'slamcu_change_to_map_seconds_count{kind="new"} 1.0' in told
    assert 'slamcu_change_to_map_seconds_sum{kind="new"}' in told
    # The candidate's evidence made the map, which says so from now on: the feature starts from its prior.
    state = await town.feature_state(5)
    assert state is None or state.passes == 0


async def test_a_version_that_repeats_itself_leaves_everything_open(town: Any, reports: Any, imports: Any) -> None:
    await deleted(town, reports)
    await new(town, reports)
    before = await town.feature_state(1)
    assert await imports("2026.06", {1: (0.2, 0.1)}) == Rebased(still_open=2)
    assert await states(town) == [("deleted", "confirmed"), ("new", "confirmed")]
    after = await town.feature_state(1)
    assert (after.passes, after.weight_against) == (before.passes, before.weight_against)  # it stayed, so did these


async def test_a_feature_that_is_stated_anew_contradicts_its_deletion(town: Any, reports: Any, imports: Any) -> None:
    await deleted(town, reports)
    assert await imports("2026.06", {1: (4.0, 0.0)}) == Rebased(contradicted=1)
    assert await states(town) == [("deleted", "contradicted")]
    assert (await town.feature_state(1)).passes == 0
    # Who has the old version still speaks of the old place.
    await town.report("late", reports.missed(1, hours=20))
    await town.fuse()
    assert (await town.feature_state(1)).passes == 0
    # Fresh evidence about the new place is heard.
    for number in range(6):
        await town.report(f"car-{number}", reports.missed(1, hours=30 + number), version="2026.06")
    await town.fuse()
    assert await states(town) == [("deleted", "contradicted"), ("deleted", "confirmed")]


async def test_a_survey_contradicts_what_it_does_not_show(town: Any, reports: Any, imports: Any) -> None:
    await deleted(town, reports)
    await new(town, reports)
    earlier = Survey(reports.at(0))  # vehicles have looked since
    assert await imports("2026.06", {1: (0.0, 0.0)}, earlier) == Rebased(still_open=2)
    elsewhere = Survey.parse(datetime(2026, 6, 1, tzinfo=UTC), "3,48,4,49")
    assert await imports("2026.07", {1: (0.0, 0.0)}, elsewhere) == Rebased(still_open=2)
    later = Survey.parse(datetime(2026, 6, 1), "2,48,3,49")  # noqa: DTZ001  (as a command gives it)
    assert await imports("2026.08", {1: (0.0, 0.0)}, later) == Rebased(contradicted=2)
    assert await states(town) == [("deleted", "contradicted"), ("new", "contradicted")]
    await town.report("c", reports.find(100, 0, hours=3), reports.missed(1, hours=30))
    await town.fuse()
    assert len(await town.changes()) == 2  # the provider knows better


@pytest.mark.parametrize(
    ("signs", "expected", "then"),
    [
        ({1: (8.1, 0.0)}, Rebased(absorbed=1), ("moved", "absorbed")),
        ({2: (8.1, 0.0)}, Rebased(absorbed=1), ("moved", "absorbed")),  # under another id
        ({1: (0.0, 20.0)}, Rebased(contradicted=1), ("moved", "contradicted")),
        ({1: (0.0, 0.0)}, Rebased(still_open=1), ("moved", "confirmed")),
        ({}, Rebased(still_open=1), ("new", "confirmed")),  # half of it
        ({1: (0.0, 0.0), 2: (8.1, 0.0)}, Rebased(still_open=1), ("deleted", "confirmed")),  # the other half
    ],
)
async def test_a_move_is_settled_by_both_its_ends(
    *, town: Any, reports: Any, imports: Any, signs: Any, expected: Rebased, then: tuple[str, str]
) -> None:
    await moved(town, reports)
    assert await states(town) == [("moved", "confirmed")]
    assert await imports("2026.06", signs) == expected
    assert await states(town) == [then]


def test_a_survey_needs_a_time_and_a_box_that_can_be_read() -> None:
    assert Survey.parse(None, None) is None
    with pytest.raises(SlamcuError, match="--surveyed-bbox goes with"):
        Survey.parse(None, "1,2,3,4")
    with pytest.raises(SlamcuError, match="--surveyed-bbox"):
        Survey.parse(datetime(2026, 6, 1, tzinfo=UTC), "1,2,3")
