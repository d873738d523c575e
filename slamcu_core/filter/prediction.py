"""Prediction, eq. 12: every particle moves by the odometry as its own constants correct it, plus white noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcu_core.filter.particles import Particles
from slamcu_core.models import MotionNoise, advance

_MAX_TURN = 0.2  # rad; the path within one prediction is an arc, so keep it short
_MAX_TIME = 0.5  # s
_NOMINAL = np.array([1.0, 1.0, 0.0])  # speed scale, yaw scale, yaw bias of a vehicle without fault


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

    The vehicle's constants are sampled; the noise of distance and turn stays open (`Particles.pending`), so that the
    next measurement can say where to sample.
    """
    if travel.time <= 0.0 or (travel.distance == 0.0 and travel.turn == 0.0):
        return
    particles.settle(rng)
    state = particles.state
    keep = np.exp(-travel.time / noise.constant_time_s)
    wander = np.sqrt(1.0 - keep**2) * noise.constants_std * rng.standard_normal((len(particles), 3))
    state[:, 3:] = _NOMINAL + keep * (state[:, 3:] - _NOMINAL) + wander
    distance = travel.distance * state[:, 3]
    turn = travel.turn * state[:, 4] + state[:, 5] * travel.time
    moved = advance(particles.pose, distance, turn)
    middle = state[:, 2] + 0.5 * turn
    distance_std = noise.distance_std * np.sqrt(abs(travel.distance))
    turn_std = np.sqrt(noise.turn_std**2 * abs(travel.turn) + noise.drift_std**2 * travel.time)
    factor = np.zeros((len(particles), 3, 2))
    factor[:, 0, 0], factor[:, 1, 0] = distance_std * np.cos(middle), distance_std * np.sin(middle)
    # a wrong turn swings the chord about its start by half of itself
    factor[:, 0, 1] = -0.5 * turn_std * (moved[:, 1] - state[:, 1])
    factor[:, 1, 1] = 0.5 * turn_std * (moved[:, 0] - state[:, 0])
    factor[:, 2, 1] = turn_std
    particles.pending = factor
    state[:, :3] = moved
