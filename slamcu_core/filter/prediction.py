"""Prediction, eq. 12: every particle moves by the odometry as its own constants correct it, plus white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slamcu_core.filter.particles import Particles
from slamcu_core.models import MotionNoise, chord

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
    keep = math.exp(-travel.time / noise.constant_time_s)
    wander = math.sqrt(1.0 - keep**2) * noise.constants_std * rng.standard_normal((len(particles), 3))
    state[:, 3:] = _NOMINAL * (1.0 - keep) + keep * state[:, 3:] + wander
    x, y, heading, speed_scale, yaw_scale, yaw_bias = state.T
    distance = travel.distance * speed_scale
    turn = travel.turn * yaw_scale + yaw_bias * travel.time
    along, across = chord(heading, distance, turn)
    distance_std = noise.distance_std * math.sqrt(abs(travel.distance))
    turn_std = math.sqrt(noise.turn_std**2 * abs(travel.turn) + noise.drift_std**2 * travel.time)
    middle = heading + 0.5 * turn
    factor = np.empty((3, 2, len(particles)))
    factor[0, 0], factor[1, 0], factor[2, 0] = distance_std * np.cos(middle), distance_std * np.sin(middle), 0.0
    # a wrong turn swings the chord about its start by half of itself
    factor[0, 1], factor[1, 1], factor[2, 1] = -0.5 * turn_std * across, 0.5 * turn_std * along, turn_std
    particles.pending = factor
    x += along
    y += across
    heading += turn
