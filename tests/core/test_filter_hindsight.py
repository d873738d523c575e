"""What was found and left behind moves with what is learnt of the pose later, as a Kalman smoother would move it."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
import pytest

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, GnssFix, InitialPose, Odometry, Record, Sensor
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.filter.calibration import Calibrations, GnssBias
from slamcu_core.filter.hindsight import Hindsight
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.prediction import Travel, linearized, predict
from slamcu_core.filter.resampling import resample
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature
from slamcu_core.models import MotionNoise

FRAME = LocalFrame(2.1, 48.9)
SPEED = 20.0
NOISE = MotionNoise()
STEADY = MotionNoise(speed_scale_std=0.001, yaw_bias_std=2e-5, drift_std=1e-4)  # what was seen and now is one


def test_the_motion_is_linearized_as_it_moves() -> None:
    mean, travel = np.array([10.0, 5.0, 0.7, 1.01, 0.99, 5e-4]), Travel(2.0, 0.03, 0.07)
    moved, by_state, _ = linearized(mean, travel, NOISE)
    steps = 1e-6 * np.eye(6)
    numeric = np.array([(linearized(mean + step, travel, NOISE)[0] - moved) / 1e-6 for step in steps]).T
    np.testing.assert_allclose(by_state, numeric, atol=1e-5)


def test_the_motion_of_a_gaussian_is_that_of_its_particles() -> None:
    rng = np.random.default_rng(1)
    particles = Particles.sample(40_000, 1, position_std=1.0, heading=0.3, heading_std=0.02, noise=NOISE, rng=rng)
    (mean, covariance), travel = particles.mean_state(), Travel(30.0, 0.1, 1.0)
    predict(particles, travel, NOISE, rng)
    moved, by_state, noise = linearized(mean, travel, NOISE)
    expected = by_state @ covariance @ by_state.T + noise
    got, spread = particles.mean_state()
    np.testing.assert_allclose(got, moved, atol=0.03)
    std = np.sqrt(expected.diagonal())
    np.testing.assert_allclose(spread / np.outer(std, std), expected / np.outer(std, std), atol=0.03)


class _Car:
    """Particles that have found one thing 30 m ahead of where each of them is, and drive on."""

    def __init__(self, count: int, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.particles = Particles.sample(
            count, 2, position_std=1.5, heading=0.0, heading_std=0.002, noise=STEADY, rng=self.rng
        )
        self.particles.means[:, 1] = self.particles.state[:2] + np.array([[30.0], [5.0]])
        self.particles.covariances[:, 1] = np.array([0.04, 0.0, 0.04])[:, None]
        self.table, parameters = FeatureTable(), FilterParameters()
        self.row = self.table.add(Kind.NEW, feature_class=1, sign=0, value=0)
        self.table.slot[self.row], self.table.xy[self.row] = 1, (30.0, 5.0)
        self.hindsight = Hindsight(
            self.table,
            self.particles,
            gnss=GnssBias(parameters, 1.5),
            calibrations=Calibrations(parameters),
            motion=STEADY,
            reach=80.0,
        )

    def drive(self, seconds: int) -> None:
        for _ in range(4 * seconds):
            travel = Travel(0.25 * SPEED, 0.0, 0.25)
            predict(self.particles, travel, STEADY, self.rng)
            self.hindsight.predict(travel)
        self.particles.settle(self.rng)

    def learn_place(self, off: tuple[float, float], std: float) -> None:
        """Measure where the car is, so far off from where it believes to be."""
        mean, _ = self.particles.mean_state()
        nu = self.particles.state[:2] - (mean[:2] + off)[:, None]
        self.particles.log_weight = -0.5 * (nu**2).sum(axis=0) / std**2
        assert resample(self.particles, 1.0, 0.6, self.rng)
        self.hindsight.learn()

    @property
    def found(self) -> tuple[np.ndarray, np.ndarray]:
        return self.table.xy[self.row].copy(), self.table.covariance[self.row].copy()


def _take_in(car: _Car) -> None:
    car.drive(12)
    car.learn_place((0.0, 0.0), 50.0)  # tells nothing
    assert car.table.slot[car.row] == -1, "it is far enough behind"
    assert car.hindsight.follows(np.array([car.row])).all()


def test_a_find_follows_by_bayes_rule() -> None:
    car = _Car(20_000)
    together = np.stack([car.particles.means[0, 1], car.particles.state[0]])
    _take_in(car)
    (x, y), (xx, _, yy) = car.found
    prior = float(np.var(together[0])) + 0.04
    assert (xx, yy) == (pytest.approx(prior, rel=0.05), pytest.approx(prior, rel=0.05))
    car.drive(10)
    measured = car.particles.mean_state()[1][:2, :2] + np.eye(2)
    car.learn_place((1.5, -1.0), 1.0)
    (later_x, later_y), (later_xx, _, later_yy) = car.found
    gain = (prior - 0.04) * np.linalg.inv(measured)
    np.testing.assert_allclose([later_x - x, later_y - y], gain @ [1.5, -1.0], atol=0.06)
    expected = prior - (gain @ measured @ gain.T).diagonal()
    np.testing.assert_allclose([later_xx, later_yy], expected, rtol=0.05)


def test_what_is_learnt_in_another_frame_is_the_same() -> None:
    here, there = _Car(2000), _Car(2000)
    for car in (here, there):
        _take_in(car)
    turn, offset = 0.4, np.array([1000.0, -50.0])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def to(place: np.ndarray) -> np.ndarray:
        return np.asarray(rotation @ (place - offset))

    particles, table = there.particles, there.table
    particles.state[:2] = rotation @ (particles.state[:2] - offset[:, None])
    particles.state[2] += turn
    particles.gnss_bias = rotation @ particles.gnss_bias
    table.xy[there.row] = to(table.xy[there.row])
    xx, xy, yy = table.covariance[there.row]
    table.covariance[there.row] = (rotation @ [[xx, xy], [xy, yy]] @ rotation.T).ravel()[[0, 1, 3]]
    there.hindsight.move(to, turn)
    off = np.array([1.5, -1.0])
    for car, where in ((here, off), (there, rotation @ off)):
        car.learn_place((float(where[0]), float(where[1])), 0.3)
    np.testing.assert_allclose(there.found[0], to(here.found[0]), atol=0.03)
    assert there.found[1][[0, 2]].sum() == pytest.approx(here.found[1][[0, 2]].sum(), rel=0.05)


def test_a_find_that_comes_near_again_is_where_each_particle_has_it() -> None:
    car = _Car(4000)
    car.drive(12)
    known = np.corrcoef(car.particles.means[0, 1], car.particles.state[0])[0, 1]
    car.learn_place((0.0, 0.0), 50.0)
    xy, covariance = car.found
    car.hindsight.recall(car.row, 0)
    assert car.table.slot[car.row] == 0
    assert not car.hindsight.follows(np.array([car.row])).any()
    mean, spread = car.particles.collapse(np.array([0]))
    np.testing.assert_allclose(mean[:, 0], xy, atol=1e-6)
    np.testing.assert_allclose(spread[:, 0], covariance, atol=0.02 * covariance[0])
    together = np.corrcoef(car.particles.means[0, 0], car.particles.state[0])[0, 1]
    assert together == pytest.approx(known, abs=0.03)


BIAS = np.array([2.0, -2.5])  # of the satellite receiver, m
MAPPED = (900.0, 6.0), (930.0, -6.0), (960.0, 6.0)
UNMAPPED = (60.0, 6.0)


def _records(seconds: float) -> Iterator[Record]:
    """Drive east past a sign that the map lacks, and long after past signs of the map."""
    rng = np.random.default_rng(3)
    for step in range(1, round(10 * seconds)):
        yield Odometry((step - 1) / 10, SPEED, yaw_rate=0.0)
        t, items = step / 10, []
        for x, y in (UNMAPPED, *MAPPED):
            distance, bearing = np.hypot(x - SPEED * t, y), np.arctan2(y, x - SPEED * t)
            if 2 < distance < 80 and abs(bearing) < np.deg2rad(20) and rng.random() < 0.9:
                noise = rng.normal(size=2) * (0.3, 0.005)
                items.append(Detection("traffic_sign", range=distance + noise[0], bearing=bearing + noise[1]))
        if step % 10 == 0:
            lon, lat = FRAME.to_geographic([SPEED * t, 0.0] + BIAS + 0.3 * rng.normal(size=2))
            yield GnssFix(t, float(lon), float(lat), 2.0)
        yield DetectionFrame(t, "camera", tuple(items))


def _place(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much the car has misplaced its find after so many seconds, and the covariance it claims."""
    camera = Sensor("camera", fov_deg=40, min_range_m=2, max_range_m=80, range_std_m=0.3, bearing_std_rad=0.005)
    lon, lat = (float(value) for value in FRAME.to_geographic(BIAS))
    start = datetime(2026, 5, 1, tzinfo=UTC)
    header = DriveHeader("v", "s", start, InitialPose(lon, lat, 90.0, 2.0, 0.5), (camera,))
    places = [FRAME.to_geographic(place) for place in MAPPED]
    features = [MapFeature(number, float(lon), float(lat)) for number, (lon, lat) in enumerate(places)]
    car = SlamcuFilter(HDMap(features), header, rng=np.random.default_rng(1))
    for record in _records(seconds):
        car.feed(record)
    (found,) = (feature for feature in car.features() if feature.feature is None)
    assert found.state == "new"
    xx, xy, yy = found.covariance_m2
    return FRAME.to_local(found.lon, found.lat) - UNMAPPED, np.array([[xx, xy], [xy, yy]])


def test_signs_of_the_map_far_ahead_correct_what_was_found_before_them() -> None:
    first, vague = _place(40.0)  # 740 m on, with the next sign of the map just out of reach
    last, sharp = _place(60.0)
    assert np.hypot(*first) > 2.0, "the receiver's bias misplaced it"
    assert np.hypot(*last) < 0.6 * np.hypot(*first)
    assert np.trace(sharp) < 0.7 * np.trace(vague)
    assert last @ np.linalg.solve(sharp, last) < 9.2, "within its 99 % ellipse"
