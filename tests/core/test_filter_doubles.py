"""A car that has found the map's features anew, from a pose beside its own, is told by their arrangement."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from slamcu_core.drive import DetectionFrame, GnssFix, Odometry, Record
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.filter.doubles import Doubles
from slamcu_core.filter.recovery import Recovery
from slamcu_core.filter.relocation import Motion
from slamcu_core.hd_map import HDMap
from tests.core.robots import FRAME, header, looked, map_of

HEADER = header(reach_m=12.0, detection_probability=0.7, position_std=0.02, heading_std_deg=1.0)
# ahead of where the robot stands
THINGS = [(3.0, 0.5), (5.1, -2.9), (6.4, 2.2), (7.6, -0.7), (9.3, 4.6), (9.1, -3.9), (10.3, 1.6), (6.5, -5.9)]
NEW = (4.6, 5.4)
ASTRAY = Motion(0.03, np.array([0.7, -0.9]))  # where the robot believes itself and all that it sees


def records(seed: int, astray: Motion) -> Iterator[Record]:
    """A robot turns to and fro for a minute where it stands; it stands elsewhere than it has been told, by `astray`."""
    rng, believed = np.random.default_rng(seed), 0.0
    place = astray.apply(np.zeros(2))
    for step in range(300):
        rate = 0.2 if step % 50 < 25 else -0.2
        yield Odometry(step / 5, 0.0, yaw_rate=rate)
        items = looked(HEADER.sensors[0], [*THINGS, NEW], place, believed + astray.angle, rng)
        yield DetectionFrame(step / 5, "camera", items)
        believed += rate / 5


def driven(seed: int, hd_map: HDMap, astray: Motion, fixes: bool = False) -> SlamcuFilter:
    car = SlamcuFilter(hd_map, HEADER, FilterParameters.robot(), rng=np.random.default_rng(seed))
    for number, record in enumerate(records(seed, astray)):
        if fixes and number % 40 == 0:
            car.feed(GnssFix(record.t, 2.1, 48.9, 3.0))
        car.feed(record)
    return car


def place_of(car: SlamcuFilter) -> np.ndarray:
    return FRAME.to_local(car.pose.lon, car.pose.lat)


def told(car: SlamcuFilter) -> tuple[list[str], list[np.ndarray]]:
    """Return the states of the map's features, and the places of what is new."""
    features = car.features()
    return (
        [f.state for f in features if f.feature is not None],
        [FRAME.to_local(f.lon, f.lat) for f in features if f.feature is None and f.state == "new"],
    )


@pytest.fixture(autouse=True)
def _no_other_way_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the search that begins in doubt aside: it may be sooner."""
    monkeypatch.setattr(Recovery, "find_the_way_back", lambda *_, **__: None)


@pytest.mark.parametrize("seed", range(4))
def test_a_robot_a_metre_beside_its_pose_is_told_by_its_finds(seed: int) -> None:
    car = driven(seed, map_of(THINGS), ASTRAY)
    assert np.hypot(*(place_of(car) - ASTRAY.apply(np.zeros(2)))) < 0.2
    assert car.health.trusted
    states, new = told(car)
    assert states == ["normal"] * len(THINGS)
    assert len(new) == 1, "what is new is one thing, not another in each world"
    assert np.hypot(*(new[0] - NEW)) < 0.3


def test_without_a_look_for_doubles_it_goes_by_what_it_has_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Doubles, "undo", lambda *_: None)
    car = driven(1, map_of(THINGS), ASTRAY)
    assert np.hypot(*(place_of(car) - ASTRAY.apply(np.zeros(2)))) > 0.4
    states, new = told(car)
    assert states.count("deleted") >= 4
    assert len(new) >= 5


def test_where_fixes_come_they_would_say_so() -> None:
    assert told(driven(1, map_of(THINGS), ASTRAY, fixes=True))[0].count("deleted") >= 4


@pytest.mark.parametrize("count", [3, 4])
@pytest.mark.parametrize("seed", range(2))
def test_a_few_things_that_were_moved_together_have_moved(seed: int, count: int) -> None:
    """Three may be so by chance, and where others are seen in their places the pose is right."""
    before = [(x - 0.8, y + 0.9) for x, y in THINGS[:count]] + THINGS[count:]
    car = driven(seed, map_of(before), Motion(0.0, np.zeros(2)))
    assert np.hypot(*place_of(car)) < 0.1
    states, new = told(car)
    assert states == ["deleted"] * count + ["normal"] * (len(THINGS) - count)
    for there in [*THINGS[:count], NEW]:
        assert min(np.hypot(*(place - there)) for place in new) < 0.2
