"""A car that lost its way and has found it again knows what it knew before, though it is less sure of it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from slamcu_core.drive import DetectionFrame, Odometry, Record
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.filter.detections import Instant
from slamcu_core.filter.estimates import FeatureEstimate
from slamcu_core.filter.retrospect import Retrospect
from tests.core.robots import FRAME, header, looked, map_of

HEADER = header(reach_m=5.0, detection_probability=0.8, position_std=0.1, heading_std_deg=3.0)
# what stands in the west, where the robot turns about itself at first, and 20 m to the east of it
WEST = [(2.0, 0.5), (0.5, 2.5), (-2.5, 1.0), (-1.5, -2.0), (1.5, -2.8), (3.5, 2.2)]
EAST = [(22.0, 0.3), (23.1, 1.9), (21.2, 2.4), (23.8, -0.6), (22.4, -1.9), (20.9, -2.5), (24.2, 2.6)]
NEW, GONE = (-3.0, -0.8), (2.8, -1.4)
CARRIED_S, END_S = 60.0, 110.0
TURN = 0.3  # rad/s


def records(seed: int, end: float = END_S) -> Iterator[Record]:
    """A robot turns about itself in the west, is carried to the east while its wheels stand, and looks around there."""
    rng, heading, place = np.random.default_rng(seed), 0.0, np.zeros(2)
    for step in range(round(5 * end)):
        t = step / 5
        if t == CARRIED_S:
            place, heading = np.array([20.0, 0.0]), -1.2
        rate = TURN if t < CARRIED_S or int(t - CARRIED_S) % 16 < 8 else -TURN
        yield Odometry(t, 0.0, yaw_rate=rate)
        items = looked(HEADER.sensors[0], [*WEST, *EAST, NEW], place, heading, rng)
        yield DetectionFrame(t, "camera", items)
        heading += rate / 5


def driven(seed: int, end: float = END_S) -> SlamcuFilter:
    car = SlamcuFilter(map_of([*WEST, *EAST, GONE]), HEADER, FilterParameters.robot(), rng=np.random.default_rng(seed))
    for record in records(seed, end):
        car.feed(record)
    return car


def told(car: SlamcuFilter) -> tuple[dict[int, FeatureEstimate], list[FeatureEstimate]]:
    features = car.features()
    return (
        {int(f.feature.object_id): f for f in features if f.feature is not None},
        [f for f in features if f.feature is None and f.masses.exists > f.masses.not_exists],
    )


def certainty(car: SlamcuFilter) -> tuple[float, float]:
    """Return how much is believed of what is gone, and of the one thing that is new."""
    mapped_as, (find,) = told(car)
    return mapped_as[len(WEST + EAST)].masses.not_exists, find.masses.exists


def right(car: SlamcuFilter) -> bool:
    """Return whether the car is right about everything, whatever it sees now."""
    mapped_as, finds = told(car)
    states = {number: feature.state for number, feature in mapped_as.items()}
    places = [FRAME.to_local(find.lon, find.lat) for find in finds]
    return (
        states == dict.fromkeys(range(len(WEST + EAST)), "normal") | {len(WEST + EAST): "deleted"}
        and len(places) == 1
        and bool(np.hypot(*(places[0] - NEW)) < 0.1)
    )


@pytest.mark.parametrize("seed", range(3))
def test_what_a_robot_knew_before_it_was_carried_off_it_knows_when_it_has_found_itself(seed: int) -> None:
    before = driven(seed, CARRIED_S)
    assert right(before)
    car = driven(seed, CARRIED_S)
    astray = False
    for record in list(records(seed))[2 * round(5 * CARRIED_S) :]:
        car.feed(record)
        astray |= not right(car)
    assert astray, "it believed what a wrong pose made of what it saw"
    place = FRAME.to_local(car.pose.lon, car.pose.lat)
    assert np.hypot(*(place - (20.0, 0.0))) < 0.1
    assert car.health.trusted
    assert right(car)
    (gone, new), (gone_less, new_less) = certainty(before), certainty(car)
    assert min(gone, new) > 0.999
    assert 0.8 < gone_less < 0.9, "what was believed before is believed less"
    assert 0.45 < new_less < 0.7, "and of what was found a few misses are enough to refute it"


def test_without_a_moment_from_before_all_of_the_drive_is_forgotten() -> None:
    car = driven(0, CARRIED_S)
    for record in list(records(0))[2 * round(5 * CARRIED_S) :]:
        car.feed(record)
        if record.t < CARRIED_S + 8.0:
            car._whereabouts._retrospect.forget()
    mapped_as, finds = told(car)
    assert not finds
    assert mapped_as[len(WEST + EAST)].state == "normal", "as the map has it"
    assert np.hypot(*(FRAME.to_local(car.pose.lon, car.pose.lat) - (20.0, 0.0))) < 0.1


def test_what_was_left_behind_meanwhile_comes_back_too_and_what_was_found_meanwhile_does_not() -> None:
    car = driven(1, CARRIED_S)
    around, table, particles = car._around, car._table, car._particles
    now = Instant(CARRIED_S, 1.0, 1.0, particles.mean_state()[0][:3], car._reckoning.pose, 0.0)
    (find,) = (table.alive & (table.number > 0)).nonzero()[0].tolist()
    since = table.copied(np.array([find]))
    since["number"] += 1
    since["born"][:] = CARRIED_S
    for row in (find, int(table.paste(since)[0])):  # one from before and one from since then was left behind
        table.open[row], table.slot[row] = False, -1
        around.found.put(table, row, around.frame)
    gone = table.source == len(WEST + EAST)
    table.weight_for[gone] = 12.0  # and seen from the wrong pose
    table.open[:] = False
    around.refresh(np.array([5_000.0, 0.0]), particles)  # and so are all features of the map
    table.paste(since)  # one of the car's own making is near
    assert (table.used, len(around.found)) == (1, 2)
    assert not right(car)
    assert car._whereabouts._retrospect.bring_back(now)
    around.refresh(np.zeros(2), particles, force=True)
    assert right(car)
    assert len(around.found) == 0


def test_a_pose_that_agrees_by_dead_reckoning_tells_which_moment_was_the_last_good_one() -> None:
    car = driven(2, CARRIED_S)
    retrospect: Retrospect = car._whereabouts._retrospect
    last = retrospect._moments[-1]
    particles, reckoned = car._particles, car._reckoning.pose
    now = Instant(CARRIED_S, 1.0, 1.0, last.pose, reckoned, 0.0)
    assert retrospect._before_the_loss(now) == len(retrospect._moments) - 1
    particles.state[0] += 3.0  # now known to be 3 m off: no moment agrees, so one well before anything was amiss
    early = retrospect._before_the_loss(now)
    assert early is not None
    assert CARRIED_S - 34.0 < retrospect._moments[early].t <= CARRIED_S - 30.0
