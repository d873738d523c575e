"""Wheels that do not do what odometry says: how often, and a robot that is held fast while it is told to turn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, InitialPose, Odometry, Record, Sensor
from slamcu_core.filter import FilterParameters, SlamcuFilter, careful_update
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.prediction import Travel, predict
from slamcu_core.geometry import LocalFrame, wrap_angle
from slamcu_core.hd_map import HDMap, MapFeature, MapIdentity
from slamcu_core.models import MotionNoise

FRAME = LocalFrame(2.1, 48.9)
LANDMARKS = ((2.0, 0.3), (3.0, -1.2), (2.5, 1.6), (4.5, 0.5), (1.0, 3.0), (-1.0, 2.5), (-2.5, 0.0), (-1.0, -2.0))
CAMERA = Sensor(
    "camera", fov_deg=60, min_range_m=0.3, max_range_m=6, rate_hz=10, range_std_m=0.05, range_std_rel=0.03,
    bearing_std_rad=0.03, detection_probability=0.5,
)  # fmt: skip
HEADER = DriveHeader("robot", "s", datetime(2026, 5, 1, tzinfo=UTC), InitialPose(2.1, 48.9, 90.0, 0.1, 3.0), (CAMERA,))


def test_particles_slip_for_their_share_of_the_time_and_not_at_all_where_that_is_none() -> None:
    rng = np.random.default_rng(1)
    noise = replace(MotionNoise.robot(), slip_share=0.1, slip_time_s=2.0)
    particles = Particles.sample(4000, 1, position_std=0.0, heading=0.0, heading_std=0.0, noise=noise, rng=rng)
    starts = 0
    for _ in range(100):
        before = particles.grip < 1.0
        predict(particles, Travel(0.02, 0.0, 0.2), noise, rng)
        starts += int(((particles.grip < 1.0) & ~before).sum())
    slipping = particles.grip < 1.0
    assert 0.08 < slipping.mean() < 0.12
    assert 0.45 < particles.grip[slipping].mean() < 0.55  # any share of the motion is made
    assert 1.7 < 20.0 * 0.1 * 4000 / starts < 2.3  # s a slip lasts

    predict(particles, Travel(0.02, 0.0, 0.2), replace(noise, slip_share=0.0), rng)
    spread = Particles.sample(4000, 1, position_std=0.0, heading=0.0, heading_std=0.0, noise=MotionNoise(), rng=rng)
    predict(spread, Travel(1.0, 0.0, 0.2), MotionNoise(), rng)
    assert (spread.grip == 1.0).all()


def test_a_robot_that_is_held_fast_while_it_is_told_to_turn_knows_its_heading_afterwards() -> None:
    def lost(slip_share: float) -> int:
        return sum(_heading_error(seed, slip_share=slip_share) > 0.2 for seed in range(16))

    assert 2 * lost(MotionNoise.robot().slip_share) < lost(0.0)


def _heading_error(seed: int, *, slip_share: float) -> float:
    """Return the error of the heading (rad) a while after a turn of which the first 4.5 s were not made."""
    landmarks = [MapFeature(key, *map(float, FRAME.to_geographic(place))) for key, place in enumerate(LANDMARKS, 1)]
    parameters = FilterParameters.robot()
    parameters = replace(parameters, motion=replace(parameters.motion, slip_share=slip_share))
    robot = SlamcuFilter(
        HDMap(landmarks, MapIdentity("arena", "1")), HEADER, parameters, rng=np.random.default_rng(seed)
    )
    drive = list(_held_fast(np.random.default_rng(seed)))
    for record, _ in drive:
        robot.feed(record)
    heading = drive[-1][1]
    return abs(float(wrap_angle(np.radians(90.0 - robot.pose.heading_deg) - heading)))


def _held_fast(rng: np.random.Generator) -> Iterator[tuple[Record, float]]:
    """Stand, be told to turn at 0.4 rad/s for 7.5 s and do so for the last 3 of them, and stand; with the truth."""
    heading = 0.0
    for step in range(1, 166):
        told = 0.4 if 30 <= step < 105 else 0.0
        heading += 0.1 * told if step >= 75 else 0.0
        yield Odometry((step - 1) / 10, 0.0, yaw_rate=told), heading
        seen = []
        for x, y in LANDMARKS:
            distance, bearing = np.hypot(x, y), float(wrap_angle(np.arctan2(y, x) - heading))
            if distance < 6.0 and abs(bearing) < np.pi / 6 and rng.random() < 0.5:
                distance += (0.05 + 0.03 * distance) * rng.standard_normal()
                bearing += 0.03 * rng.standard_normal()
                seen.append(Detection("traffic_sign", range=float(distance), bearing=float(bearing)))
        yield DetectionFrame(step / 10, "camera", tuple(seen)), heading


@pytest.mark.parametrize("seed", [0, 5])
def test_particles_drawn_for_a_surprise_weigh_the_same_a_part_at_a_time(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    in_parts, surprises = careful_update._weigh_in_parts, 0

    def counted(*arguments: Any) -> Any:
        nonlocal surprises
        surprises += 1
        return in_parts(*arguments)

    monkeypatch.setattr(careful_update, "_weigh_in_parts", counted)
    error = _heading_error(seed, slip_share=0.1)
    assert surprises
    monkeypatch.setattr(careful_update, "_PART", 10**9)
    assert _heading_error(seed, slip_share=0.1) == error
