"""Fixes against the pose: outliers change nothing, fixes that agree set it right unless the map says that it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import UTC, datetime

import numpy as np
import pytest
from numpy.typing import NDArray

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, GnssFix, InitialPose, Odometry, Record, Sensor
from slamcu_core.filter import SlamcuFilter
from slamcu_core.filter.health import HealthMonitor
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature

FRAME = LocalFrame(2.1, 48.9)
CAMERA = Sensor(
    "camera", fov_deg=40, max_range_m=80, rate_hz=10, range_std_m=0.3, range_std_rel=0.03, bearing_std_rad=0.006
)
START = datetime(2026, 5, 1, tzinfo=UTC)
HEADER = DriveHeader("veh", "s", START, InitialPose(2.1, 48.9, 90.0, 1.5, 2.0), (CAMERA,))
SPEED = 25.0

Shift = Callable[[float, np.random.Generator], tuple[float, float]]


def no_shift(_t: float, _rng: np.random.Generator) -> tuple[float, float]:
    return 0.0, 0.0


def signs(seed: int = 5) -> NDArray[np.float64]:
    """Return signs of an eastward road, at uneven distances so that no two stretches look alike."""
    rng = np.random.default_rng(seed)
    return np.stack(
        [80.0 + np.cumsum(rng.uniform(30, 110, 40)), rng.choice([-1, 1], 40) * rng.uniform(4, 9, 40)], axis=1
    )


class Ride:
    """A car at 25 m/s that is told and shown what a test likes, and its errors."""

    def __init__(self, places: NDArray[np.float64] | None = None, seed: int = 3, std: float = 2.5) -> None:
        self.std = std
        self.places = np.zeros((0, 2)) if places is None else places
        features = []
        for key, place in enumerate(self.places, 1):
            lon, lat = FRAME.to_geographic(place)
            features.append(MapFeature(key, float(lon), float(lat), sign="YIELD"))
        self.car = SlamcuFilter(HDMap(features), HEADER, rng=np.random.default_rng(seed))
        self.rng = np.random.default_rng(seed + 50)
        self.t = self.x = 0.0
        self.errors: list[float] = []
        self.trusted: list[bool] = []

    def drive(
        self,
        seconds: float,
        *,
        shift: Shift = no_shift,
        told: float = SPEED,
        speed: float = SPEED,
        fixes: bool = True,
    ) -> None:
        """Drive at a `speed` while odometry says `told`; fixes, one a second or none, are off by `shift`."""
        for record in self._records(seconds, shift, told, speed):
            if fixes or not isinstance(record, GnssFix):
                self.car.feed(record)
            if isinstance(record, DetectionFrame):
                pose = self.car.pose
                self.errors.append(float(np.hypot(*(FRAME.to_local(pose.lon, pose.lat) - [self.x, 0.0]))))
                self.trusted.append(self.car.health.trusted)

    def _records(self, seconds: float, shift: Shift, told: float, speed: float) -> Iterator[Record]:
        for _ in range(round(10 * seconds)):
            yield Odometry(self.t, told, 0.0)
            self.t, self.x = round(self.t + 0.1, 6), self.x + 0.1 * speed
            yield Odometry(self.t, told, 0.0)
            if round(10 * self.t) % 10 == 0:
                noise = self.rng.normal(0.0, 0.4 * self.std, 2)
                lon, lat = FRAME.to_geographic(np.array([self.x, 0.0]) + noise + shift(self.t, self.rng))
                yield GnssFix(self.t, float(lon), float(lat), self.std)
            yield DetectionFrame(self.t, "camera", tuple(self._seen()))

    def _seen(self) -> Iterator[Detection]:
        for x, y in self.places - [self.x, 0.0]:
            distance, bearing = float(np.hypot(x, y)), float(np.arctan2(y, x))
            if distance < 80.0 and abs(bearing) < np.radians(20) and self.rng.random() < 0.9:
                distance += (0.3 + 0.03 * distance) * self.rng.standard_normal()
                bearing += 0.006 * self.rng.standard_normal()
                yield Detection("traffic_sign", range=distance, bearing=bearing, sign="YIELD")


@pytest.mark.parametrize("outlier", [60.0, 200.0, 5000.0])
@pytest.mark.parametrize("seed", range(4))
def test_one_reflected_fix_changes_nothing(outlier: float, seed: int) -> None:
    plain, hit = Ride(seed=seed), Ride(seed=seed)
    for ride, far in ((plain, 0.0), (hit, outlier)):
        ride.drive(30.0)
        ride.drive(1.0, shift=lambda _t, _rng, far=far: (0.0, far))  # type: ignore[misc]
        ride.drive(30.0)
    assert (plain.car.fixes.refused, hit.car.fixes.refused) == (0, 1)
    assert max(hit.errors[300:]) < max(plain.errors[300:]) + 1.0
    assert all(hit.trusted)


@pytest.mark.parametrize("with_signs", [False, True])
@pytest.mark.parametrize(
    ("seconds", "told", "speed"),
    [(0.5, 149.0, SPEED), (2.0, 0.0, SPEED), (10.0, SPEED, 0.0)],
    ids=["a wild speed", "speed 0 while driving", "driving while it stands"],
)
@pytest.mark.parametrize("seed", [3, 4])
def test_an_odometer_that_told_nonsense_is_set_right_within_seconds(
    seconds: float, told: float, speed: float, seed: int, with_signs: bool
) -> None:
    ride = Ride(signs() if with_signs else None, seed)
    ride.drive(10.0)
    ride.drive(seconds, told=told, speed=speed, fixes=speed > 0.0)
    begin = len(ride.errors)
    ride.drive(30.0)
    fixes = 10 if with_signs else 6  # to take signs for others costs a few
    assert ride.errors[begin] > 40.0
    assert max(ride.errors[begin + 10 * fixes :]) < (3.0 if with_signs else 8.0)
    assert not all(ride.trusted[begin : begin + 60])
    assert all(ride.trusted[begin + 150 :])
    assert ride.car.fixes.restarts == 1


def test_fixes_that_jump_aside_together_take_the_pose_along_and_their_bias_stays_one() -> None:
    ride = Ride()
    ride.drive(10.0)
    ride.drive(20.0, shift=lambda _t, _rng: (0.0, 300.0))
    assert max(abs(error - 300.0) for error in ride.errors[160:]) < 8.0
    assert not all(ride.trusted[100:160])
    assert all(ride.trusted[220:])


def test_fixes_that_creep_away_are_no_bias_for_ever() -> None:
    ride = Ride()
    ride.drive(10.0)
    ride.drive(120.0, shift=lambda t, _rng: (0.0, 1.5 * (t - 10.0)))
    assert abs(ride.errors[-1] - 180.0) < 40.0


def test_a_good_receiver_whose_antenna_and_datum_are_aside_is_not_held_against_the_pose() -> None:
    ride = Ride(signs(), std=0.05)
    ride.drive(60.0, shift=lambda _t, _rng: (1.5, -1.2))
    assert (ride.car.fixes.refused, ride.car.fixes.restarts) == (0, 0)
    assert not ride.car.fixes.contradicted


def test_reflections_that_do_not_agree_move_nothing() -> None:
    ride = Ride()
    ride.drive(10.0)
    ride.drive(20.0, shift=lambda _t, rng: tuple(rng.choice([-1, 1], 2) * rng.uniform(40, 200, 2)))
    assert ride.car.fixes.restarts == 0
    assert ride.car.fixes.refused >= 20
    assert max(ride.errors[100:]) < 10.0


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_where_the_map_s_signs_are_seen_as_they_should_be_fixes_that_agree_are_what_is_wrong(seed: int) -> None:
    ride = Ride(signs(), seed)
    ride.drive(12.0)
    ride.drive(25.0, shift=lambda _t, _rng: (30.0, 40.0))
    assert ride.car.fixes.suspect
    assert ride.car.fixes.restarts == 0
    assert max(ride.errors[120:]) < 3.0
    assert ride.trusted[-1]
    ride.drive(10.0)
    assert not ride.car.fixes.suspect


def test_features_that_are_missed_or_fit_badly_do_not_vouch_for_the_pose() -> None:
    def vouches(hits: list[float], squares: list[float]) -> bool:
        monitor = HealthMonitor(concentration=4.0, gate=13.8, unmapped_share=0.2)
        monitor.ask_the_map()
        count = len(hits)
        for step in range(4):
            monitor.note(
                0.3 * step,
                np.arange(count),
                np.ones(count, bool),
                shown=np.ones(count),
                due=np.full(count, 0.9),
                hit=np.array(hits),
                exists=lambda rows: np.full(len(rows), 0.95),
                squares=np.array(squares),
            )
        return monitor.map_vouches

    assert vouches([1.0, 1.0, 1.0], [1.0, 1.0, 1.0])
    assert not vouches([1.0], [1.0])
    assert not vouches([1.0, 1.0, 0.0], [1.0, 1.0, 0.0])
    assert not vouches([1.0, 1.0, 1.0], [1.0, 1.0, 13.0])
