"""The kinematic motion model behind eq. 12, from speed with yaw rate or with steering."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.errors import SlamcuError, check_within

Array = NDArray[np.float64]

_TINY = 1e-300  # rad; nothing beside any angle but 0, and sin(x) / x is 1 there


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """How far odometry may be wrong: white noise by distance and turn, and constants that each vehicle has wrong.

    The constants are part of each particle, so the filter learns them; they wander about their nominal values within
    `constant_time_s`, or a cloud of particles would settle on a wrong value for ever. The defaults suit a car.
    """

    distance_std: float = 0.02  # m per square root of a metre driven
    turn_std: float = 0.02  # rad per square root of a radian turned
    drift_std: float = 0.0006  # rad per square root of a second, while moving
    speed_scale_std: float = 0.01  # of the speed, constant per vehicle
    yaw_scale_std: float = 0.01  # of the yaw rate, constant per vehicle
    yaw_bias_std: float = 0.001  # rad/s, constant per drive
    constant_time_s: float = 300.0  # s; time in which a constant may change (tyres warm up, a gyro drifts)
    slip_share: float = 0.0  # of the time, wheels do not do what odometry says ...
    slip_time_s: float = 2.0  # s; ... for so long at a time
    hold_s: float = 1.5  # s for which a record of odometry holds if no other comes: longer than its period
    untold_speed: float = 10.0  # m/s, standard deviation beyond; that of the last record if it is more
    untold_turn: float = 0.2  # rad/s, likewise

    def __post_init__(self) -> None:
        """Raise FieldError, naming the field, for what no vehicle's odometry is like."""
        for name, low, high, unit in _RANGES:
            check_within(self, name, low, high, unit)

    @property
    def constants_std(self) -> Array:
        """Standard deviations (3,) of speed scale, yaw scale and yaw bias."""
        return np.array([self.speed_scale_std, self.yaw_scale_std, self.yaw_bias_std])

    @classmethod
    def robot(cls) -> MotionNoise:
        """Return the noise of a small wheeled robot that logs commanded, not measured, speeds."""
        return cls(
            distance_std=0.05,
            turn_std=0.1,
            drift_std=0.02,
            speed_scale_std=0.05,
            yaw_scale_std=0.12,
            yaw_bias_std=0.005,
            constant_time_s=60.0,
            slip_share=0.1,
            untold_speed=0.3,
            untold_turn=0.5,
        )


_RANGES = (
    ("distance_std", 0.0, 100.0, "m per square root of a metre"),
    ("turn_std", 0.0, 10.0, "rad per square root of a radian"),
    ("drift_std", 0.0, 10.0, "rad per square root of a second"),
    ("speed_scale_std", 0.0, 1.0, "of the speed"),
    ("yaw_scale_std", 0.0, 1.0, "of the yaw rate"),
    ("yaw_bias_std", 0.0, 1.0, "rad/s"),
    ("constant_time_s", 1e-3, 1e9, "s"),
    ("slip_share", 0.0, 0.9, "of the time"),
    ("slip_time_s", 1e-3, 1e6, "s"),
    ("hold_s", 0.01, 3_600.0, "s"),
    ("untold_speed", 0.0, 150.0, "m/s"),
    ("untold_turn", 0.0, 10.0, "rad/s"),
)


def yaw_rate_from_steering(speed: float, steering: float, wheelbase_m: float | None) -> float:
    """Return the yaw rate (rad/s) of a bicycle model with front wheel angle `steering` (rad).

    Raises SlamcuError if the wheelbase is not known.
    """
    if wheelbase_m is None:
        raise SlamcuError("odometry with steering needs the vehicle's wheelbase_m")
    return speed * float(np.tan(steering)) / wheelbase_m


def arc(heading: Array, distance: Array, turn: Array) -> tuple[Array, Array]:
    """Return the directions (2, M) and chords (2, M) in m of arcs of length `distance` (M,) m that turn by `turn` (M,).

    The chord of an arc is distance · sinc(turn / 2) in the direction of the middle heading: exact for constant speed
    and yaw rate, and smooth through turn = 0.
    """
    half = 0.5 * turn
    middle = heading + half
    half += _TINY
    length = distance * np.sin(half)
    length /= half
    direction = np.empty((2, len(middle)))
    np.cos(middle, out=direction[0])
    np.sin(middle, out=direction[1])
    return direction, length * direction


def advance(pose: Array, distance: float, turn: float) -> Array:
    """Return a pose (3,) moved along a circular arc of length `distance` (m) that turns by `turn` (rad)."""
    x, y, heading = pose.tolist()
    half = 0.5 * turn
    length = distance * (math.sin(half) / half if half else 1.0)
    return np.array([x + length * math.cos(heading + half), y + length * math.sin(heading + half), heading + turn])
