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
    """Predict x_t ~ p(x_t | x_{t-1}, u_t) for every particle (eq. 12), in place.

    The vehicle's constants are sampled; the noise of distance and turn stays open as a covariance of each pose
    (`Particles.pending`), so that the next measurement can say where to sample.
    """
    if travel.time <= 0.0 or (travel.distance == 0.0 and travel.turn == 0.0):
        return
    state = particles.state
    keep = np.exp(-travel.time / noise.constant_time_s)
    nominal = np.array([1.0, 1.0, 0.0])
    wander = np.sqrt(1.0 - keep**2) * noise.constants_std * rng.standard_normal((len(particles), 3))
    state[:, 3:] = nominal + keep * (state[:, 3:] - nominal) + wander
    distance = travel.distance * state[:, 3]
    turn = travel.turn * state[:, 4] + state[:, 5] * travel.time
    moved = advance(particles.pose, distance, turn)
    step = moved[:, :2] - state[:, :2]
    middle = state[:, 2] + 0.5 * turn
    by_heading = np.stack([-step[:, 1], step[:, 0], np.ones(len(particles))], axis=-1)
    by_distance = np.stack([np.cos(middle), np.sin(middle), np.zeros(len(particles))], axis=-1)
    by_turn = by_heading * np.array([0.5, 0.5, 1.0])
    # F P Fᵀ with F = I but for the last column, which is `by_heading`
    pending = particles.pending
    shift = by_heading[:, :2]
    cross = pending[:, :2, 2]
    heading = pending[:, 2, 2, None, None]
    pending[:, :2, :2] += (
        shift[:, :, None] * cross[:, None, :]
        + cross[:, :, None] * shift[:, None, :]
        + heading * shift[:, :, None] * shift[:, None, :]
    )
    pending[:, :2, 2] += shift * pending[:, 2, 2, None]
    pending[:, 2, :2] = pending[:, :2, 2]
    pending += noise.distance_std**2 * abs(travel.distance) * by_distance[:, :, None] * by_distance[:, None, :]
    turn_variance = noise.turn_std**2 * abs(travel.turn) + noise.drift_std**2 * travel.time
    pending += turn_variance * by_turn[:, :, None] * by_turn[:, None, :]
    state[:, :3] = moved
