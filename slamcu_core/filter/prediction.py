"""Prediction, eq. 12: every particle moves by the odometry as its own constants correct it, plus white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.particles import Particles
from slamcu_core.models import MotionNoise, arc

Array = NDArray[np.float64]

_MAX_TURN = 0.2  # rad; the path within one prediction is an arc, so keep it short
_MAX_TIME = 0.5  # s
_NOMINAL = np.array([[1.0], [1.0], [0.0]])  # speed scale, yaw scale, yaw bias of a vehicle without fault


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
    kernel = particles.left_open
    if kernel is None:
        particles.settle(rng)
    state = particles.state
    keep = math.exp(-travel.time / noise.constant_time_s)
    constants = state[3:]
    constants *= keep
    constants += (1.0 - keep) * _NOMINAL
    wander = math.sqrt(1.0 - keep**2) * noise.constants_std
    constants += (wander * rng.standard_normal((len(particles), 3))).T
    speed_scale, yaw_scale, yaw_bias = constants[0], constants[1], constants[2]
    turn = travel.turn * yaw_scale
    distance = travel.distance * speed_scale
    if noise.slip_share > 0.0:
        _slip(particles, travel.time, noise, rng)
        turn *= particles.grip
        distance *= particles.grip
    turn += yaw_bias * travel.time
    direction, chord = arc(state[2], distance, turn)
    distance_std = noise.distance_std * math.sqrt(abs(travel.distance))
    turn_std = math.sqrt(noise.turn_std**2 * abs(travel.turn) + noise.drift_std**2 * travel.time)
    pending = np.empty((3, 2, len(particles)))
    np.multiply(direction, distance_std, out=pending[:2, 0])
    # a wrong turn swings the chord about its start by half of itself
    np.multiply(chord[1], -0.5 * turn_std, out=pending[0, 1])
    np.multiply(chord[0], 0.5 * turn_std, out=pending[1, 1])
    pending[2, 0], pending[2, 1] = 0.0, turn_std
    if kernel is not None:  # of the last resampling: a pose that is turned goes another way
        kernel[0] -= chord[1] * kernel[2]
        kernel[1] += chord[0] * kernel[2]
        pending = np.concatenate([kernel, pending], axis=1)
    particles.pending = pending
    state[:2] += chord
    state[2] += turn


def linearized(mean: Array, travel: Travel, noise: MotionNoise) -> tuple[Array, Array, Array]:
    """Return eq. 12 for a Gaussian of the sampled state: mean (6,), ∂/∂state (6, 6), covariance of the noise (6, 6).

    The path is straight but for where it leads: the arc's chord has its length.
    """
    keep = math.exp(-travel.time / noise.constant_time_s)
    constants = keep * mean[3:] + (1.0 - keep) * _NOMINAL[:, 0]
    speed_scale, yaw_scale, yaw_bias = constants.tolist()
    turn = travel.turn * yaw_scale + yaw_bias * travel.time
    middle = float(mean[2]) + 0.5 * turn
    direction = np.array([math.cos(middle), math.sin(middle)])
    chord = travel.distance * speed_scale * direction
    swing = np.array([-0.5 * chord[1], 0.5 * chord[0], 1.0])  # of the pose, by a turn within the way
    by_state = np.eye(6)
    by_state[:2, 2] = 2.0 * swing[:2]
    by_state[:2, 3] = keep * travel.distance * direction
    by_state[:3, 4] = keep * travel.turn * swing
    by_state[:3, 5] = keep * travel.time * swing
    by_state[[3, 4, 5], [3, 4, 5]] = keep
    spread = np.zeros((6, 6))
    spread[:2, :2] = noise.distance_std**2 * abs(travel.distance) * np.outer(direction, direction)
    spread[:3, :3] += (noise.turn_std**2 * abs(travel.turn) + noise.drift_std**2 * travel.time) * np.outer(swing, swing)
    spread[[3, 4, 5], [3, 4, 5]] = (1.0 - keep**2) * noise.constants_std**2
    moved = np.concatenate([mean[:2] + chord, [mean[2] + turn], constants])
    return moved, by_state, spread


def _slip(particles: Particles, time: float, noise: MotionNoise, rng: np.random.Generator) -> None:
    """Let particles begin and end to slip, in place: stays of exponential length, and a share drawn for each slip."""
    slips = particles.grip < 1.0
    leave = -math.expm1(-time / noise.slip_time_s)
    enter = leave * noise.slip_share / (1.0 - noise.slip_share)
    drawn, share = rng.random((2, len(particles)))
    changes = drawn < np.where(slips, leave, enter)
    particles.grip = np.where(changes, np.where(slips, 1.0, share), particles.grip)
