"""Two sensors of one car have errors of their own, and each is learned from what that sensor sees."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
import pytest

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, InitialPose, Mount, Odometry, Record, Sensor
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.filter.calibration import Calibrations, SensorCalibration
from slamcu_core.filter.particles import Particles
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature
from slamcu_core.models import MotionNoise
from slamcu_core.reports import PassReport

FRAME = LocalFrame(2.1, 48.9)
SPEED = 20.0
FRONT = Sensor("front", fov_deg=50, max_range_m=70, rate_hz=10, range_std_m=0.3, range_std_rel=0.01)
REAR = Sensor(
    "rear", fov_deg=50, max_range_m=70, rate_hz=10, range_std_m=0.3, range_std_rel=0.01, mount=Mount(0, 0, 180)
)
ERRORS = {"front": (0.04, 0.005), "rear": (-0.04, -0.005)}  # of range and bearing


def _records(places: np.ndarray, seconds: float, rng: np.random.Generator) -> Iterator[Record]:
    for step in range(1, round(10 * seconds)):
        t = step / 10
        yield Odometry((step - 1) / 10, SPEED, yaw_rate=0.0)
        for sensor in (FRONT, REAR):
            scale, turn = ERRORS[sensor.id]
            x, y = (places - [SPEED * t, 0.0]).T
            distance = np.hypot(x, y)
            bearing = (np.arctan2(y, x) - np.deg2rad(sensor.mount.yaw_deg) + np.pi) % (2 * np.pi) - np.pi
            items = [
                Detection(
                    "traffic_sign",
                    range=distance[i] * (1.0 + scale) + 0.3 * rng.standard_normal(),
                    bearing=bearing[i] + turn + 0.01 * rng.standard_normal(),
                )
                for i in ((distance < 70.0) & (distance > 3.0) & (abs(bearing) < np.deg2rad(25.0))).nonzero()[0]
                if rng.random() < 0.9
            ]
            yield DetectionFrame(t, sensor.id, tuple(items))


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_front_and_a_rear_camera_that_err_the_other_way_place_signs_as_well_as_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = 40.0 + np.cumsum(rng.uniform(20.0, 50.0, 22))
    places = np.stack([x, rng.choice([-1, 1], len(x)) * rng.uniform(5.0, 9.0, len(x))], axis=1)
    new = np.arange(len(x)) % 5 == 4
    features = []
    for number in (~new).nonzero()[0].tolist():
        lon, lat = FRAME.to_geographic(places[number])
        features.append(MapFeature(number + 1, float(lon), float(lat)))
    start = InitialPose(2.1, 48.9, 90.0, 0.5, 0.5)
    header = DriveHeader("veh", "s", datetime(2026, 5, 1, tzinfo=UTC), start, (FRONT, REAR))
    car = SlamcuFilter(HDMap(features), header, FilterParameters(), rng=np.random.default_rng(seed))
    reports: list[PassReport] = []
    for record in _records(places, 36.0, rng):
        reports += car.feed(record)
    learned = car._particles.calibration @ car._particles.weights
    np.testing.assert_allclose(learned[[0, 2]], [0.04, -0.04], atol=0.015)
    np.testing.assert_allclose(learned[[1, 3]], [0.005, -0.005], atol=0.004)
    late = [report for report in reports if report.position and report.ended_at.second > 12]
    off = [
        float(np.hypot(*(places - FRAME.to_local(report.position.lon, report.position.lat)).T).min())
        for report in late
        if report.position
    ]
    assert len(off) >= 10
    assert np.mean(off) < 0.5
    found = [one for one in car.features() if one.feature is None and one.state == "new"]
    assert len(found) >= 3
    for one in found:
        assert np.hypot(*(places[new] - FRAME.to_local(one.lon, one.lat)).T).min() < 1.0


def test_what_one_sensor_is_beyond_the_first_is_what_both_have_learned() -> None:
    rng = np.random.default_rng(0)
    particles = Particles.sample(
        50, 1, position_std=1.0, heading=0.0, heading_std=0.1, noise=MotionNoise(), rng=rng, sensors=2
    )
    all_of_them = Calibrations(FilterParameters(), 2)
    first, second = SensorCalibration(all_of_them, 0), SensorCalibration(all_of_them, 1)
    before = all_of_them.variance.copy()
    second.update(particles, np.full((2, 1, 50), 0.01), np.array([40.0]), np.array([[0.01], [1e-6]]))
    assert (particles.calibration[:2] == 0.0).all()
    np.testing.assert_array_equal(all_of_them.variance[:2], before[:2])
    assert (all_of_them.variance[2:] < before[2:]).all()
    assert first.beyond_the_first(particles) == (0.0, 0.0)
    scale, turn = second.means(particles)[:, 0]
    np.testing.assert_allclose(second.beyond_the_first(particles), (scale / (1.0 + scale), turn), rtol=1e-12)
    assert all_of_them.vaguest == (before[0], before[1])
