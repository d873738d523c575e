"""Prediction, eq. 12: every particle moves by the odometry as its own constants correct it, plus white noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcu_core.filter.particles import Particles
from slamcu_core.models import MotionNoise, advance

_MAX_TURN = 0.2  # rad; the path within one prediction is an arc, so keep it short
_MAX_TIME = 0.5  # s


@dataclass(slots=True)
class Travel:
    """Odometry since the last prediction: distance (m), turn (rad) and time (s) at face value."""

    distance: float = 0.0
    turn: float = 0.0
    time: float = 0.0

    def add(self, speed: float, yaw_rate: float, dt: float) -> None:
        """Add `dt` seconds at a speed (m/s) and yaw rate (rad/s)."""
        self.distance += speed * dt
        self.turn += yaw_rate * dt
        self.time += dt

    @property
    def full(self) -> bool:
        """Whether the motion is long enough to be applied."""
        return abs(self.turn) > _MAX_TURN or self.time > _MAX_TIME


def predict(particles: Particles, travel: Travel, noise: MotionNoise, rng: np.random.Generator) -> None:
    """Sample x_t ~ p(x_t | x_{t-1}, u_t) for every particle (eq. 12), in place."""
    if travel.time <= 0.0:
        return
    moving = travel.distance != 0.0 or travel.turn != 0.0
    if not moving:
        return
    draw = rng.standard_normal((5, len(particles)))
    state = particles.state
    keep = np.exp(-travel.time / noise.constant_time_s)
    nominal = np.array([1.0, 1.0, 0.0])
    state[:, 3:] = nominal + keep * (state[:, 3:] - nominal) + np.sqrt(1.0 - keep**2) * noise.constants_std * draw[2:].T
    distance = travel.distance * state[:, 3] + noise.distance_std * np.sqrt(abs(travel.distance)) * draw[0]
    turn_std = np.sqrt(noise.turn_std**2 * abs(travel.turn) + noise.drift_std**2 * travel.time)
    turn = travel.turn * state[:, 4] + state[:, 5] * travel.time + turn_std * draw[1]
    state[:, :3] = advance(particles.pose, distance, turn)
