"""The simulated world has the paper's counts, signs as they stand beside a motorway, and a map that is out of date."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamcu_core.formats.results import ChangeState
from slamcu_core.geometry import wrap_angle
from slamcu_eval.highway import Drive, HighwayParameters, World, make_world
from slamcu_eval.highway.parameters import WorldParameters
from slamcu_eval.highway.road import make_road
from slamcu_eval.highway.traffic import Neighbour

Drives = list[tuple[World, Drive]]
KINDS = ("normal", "deleted", "new", "moved", "modified")


def test_the_default_world_is_the_papers(motorway_drives: Drives) -> None:
    for world, drive in motorway_drives:
        assert Counter(sign.truth for sign in world.signs) == {"normal": 55, "deleted": 9, "new": 39}
        assert len(world.hd_map) == 64
        assert world.standing.size == 94
        path = world.frame.to_local(drive.reference.lon, drive.reference.lat)
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(20_000.0, rel=0.01)
        assert drive.in_view.all()


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**31),
    st.fixed_dictionaries({kind: st.integers(0, 12) for kind in KINDS}),
)
def test_counts_are_kept_and_each_kind_differs_from_the_map_as_its_name_says(seed: int, counts: dict[str, int]) -> None:
    world = make_world(seed, HighwayParameters().having(length_m=6_000.0, **counts).world)
    assert {kind: n for kind, n in counts.items() if n} == dict(Counter(s.truth.value for s in world.signs))
    for sign in world.signs:
        assert (sign.place is None) == (sign.truth is ChangeState.DELETED)
        assert (sign.map_object_id is None) == (sign.map_place is None) == (sign.truth is ChangeState.NEW)
        if sign.place is None or sign.map_place is None:
            continue
        apart = np.hypot(sign.place[0] - sign.map_place[0], sign.place[1] - sign.map_place[1])
        assert (apart > 4.0) == (sign.truth is ChangeState.MOVED)
        same = (sign.sign, sign.value) == (sign.map_sign, sign.map_value)
        assert same == (sign.truth is not ChangeState.MODIFIED)


def test_the_map_is_wrong_by_10_to_15_cm(motorway_drives: Drives) -> None:
    errors = np.array(
        [
            np.subtract(sign.place, sign.map_place)
            for world, _ in motorway_drives
            for sign in world.signs
            if sign.truth is ChangeState.NORMAL
        ]
    )
    assert 0.10 <= errors.std() <= 0.15
    world = motorway_drives[0][0]
    mapped = [sign for sign in world.signs if sign.map_place is not None]
    filed = world.frame.to_local(world.hd_map.lonlat[:, 0], world.hd_map.lonlat[:, 1])
    assert np.abs(filed - np.array([sign.map_place for sign in mapped])).max() < 0.002


def test_signs_stand_on_both_sides_and_some_stand_close_together(motorway_drives: Drives) -> None:
    sides, close = Counter[bool](), 0
    for world, _ in motorway_drives:
        nearest = np.linalg.norm(world.road.xy[None, :, :] - world.places[:, None, :], axis=-1).argmin(axis=1)
        left = np.stack([-np.sin(world.road.heading[nearest]), np.cos(world.road.heading[nearest])], axis=-1)
        sides.update(((world.places - world.road.xy[nearest]) * left).sum(axis=1) > 0)
        apart = np.linalg.norm(world.places[:, None] - world.places[None, :], axis=-1)
        np.fill_diagonal(apart, np.inf)
        close += int(((apart.min(axis=1) >= 1.8) & (apart.min(axis=1) <= 4.2)).sum())
    assert min(sides.values()) > 0.15 * sum(sides.values())
    assert close / len(motorway_drives) > 4


def test_some_signs_are_common_and_have_values(motorway_drives: Drives) -> None:
    count = Counter(sign.sign for world, _ in motorway_drives for sign in world.signs if sign.sign)
    assert count["SPEED_LIMIT"] > 0.2 * sum(count.values())
    assert len(count) > 10
    assert all(sign.value for world, _ in motorway_drives for sign in world.signs if sign.sign == "SPEED_LIMIT")


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_roads_are_smooth_and_never_turn_back(seed: int) -> None:
    p = WorldParameters()
    road = make_road(p.length_m, p.min_radius_m, np.random.default_rng(seed))
    assert np.abs(road.curvature).max() <= 1.0 / p.min_radius_m + 1e-12
    assert np.abs(np.diff(road.curvature)).max() < 1e-4
    steps = np.diff(road.xy, axis=0)
    assert np.allclose(np.hypot(steps[:, 0], steps[:, 1]), 1.0, atol=1e-6)
    assert np.abs(road.heading - road.heading[0]).max() < np.deg2rad(150.0)
    s = np.array([0.0, 5_000.5, p.length_m])
    shift = road.place(s, np.full(3, 3.5)) - road.place(s, np.zeros(3))
    assert np.allclose(np.hypot(shift[:, 0], shift[:, 1]), 3.5)
    assert np.all(wrap_angle(np.arctan2(shift[:, 1], shift[:, 0]) - road.heading_at(s)) > 0.0)


def _truck(x: float, y: float) -> Neighbour:
    """Return a truck whose rear stands at x, y and that heads east, in frame 3 only."""
    return Neighbour(
        frames=np.array([3]),
        rear=np.array([[x, y]]),
        heading=np.zeros(1),
        length=16.0,
        width=2.5,
        object_class="truck",
        reported=True,
        painted=None,
    )


@pytest.mark.parametrize(
    ("sign", "hidden"),
    [((60.0, -9.0), True), ((60.0, 6.0), False), ((12.0, -9.0), False), ((19.0, -2.0), False), ((45.0, -7.0), True)],
)
def test_a_truck_hides_what_stands_behind_it(sign: tuple[float, float], hidden: bool) -> None:
    truck = _truck(20.0, -3.5)
    eye, target = np.zeros((1, 2)), np.array([sign])
    assert truck.hides(np.array([3]), eye, target).tolist() == [hidden]
    assert truck.hides(np.array([3]), target, eye).tolist() == [hidden]
    assert truck.hides(np.array([4]), eye, target).tolist() == [False]
