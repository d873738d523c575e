"""Dead reckoning: what odometry says moves the particles, up to the time of each record.

A record of odometry holds until the next one, but no longer than `MotionNoise.hold_s`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Odometry
from slamcu_core.filter.hindsight import Hindsight
from slamcu_core.filter.outage import Outage
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.prediction import Travel, predict
from slamcu_core.models import MotionNoise, advance, yaw_rate_from_steering

Array = NDArray[np.float64]


class DeadReckoning:
    """The motion of one drive."""

    def __init__(
        self,
        particles: Particles,
        hindsight: Hindsight,
        outage: Outage,
        *,
        noise: MotionNoise,
        wheelbase_m: float | None,
        rng: np.random.Generator,
    ) -> None:
        self._particles, self._hindsight, self._outage = particles, hindsight, outage
        self._noise, self._rng = noise, rng
        self._wheelbase_m = wheelbase_m
        self.time = 0.0  # s, of the last record
        self.speed = 0.0  # m/s, as last told
        self._yaw_rate = 0.0  # rad/s
        self.holds_until = np.inf  # s, what was told last; the start, from the first record on
        self.silent = False  # whether that is over, and no motion assumed
        self.travel = Travel()  # what the particles have not made yet
        self.way = 0.0  # m, driven in all
        self.pose = np.zeros(3)  # from the start of the drive: drifts, but never jumps

    def tell(self, record: Odometry) -> None:
        """Take what odometry says, which holds from its time on."""
        if record.yaw_rate is None:
            yaw_rate = yaw_rate_from_steering(record.speed, record.steering or 0.0, self._wheelbase_m)
        else:
            yaw_rate = record.yaw_rate
        self._accumulate(record.t)
        self.speed, self._yaw_rate = record.speed, yaw_rate
        self.holds_until = record.t + self._noise.hold_s
        if self.silent:
            self.silent = False
            self._outage.end()
        if self.travel.full:
            self._predict()

    def advance(self, t: float) -> None:
        """Move the particles to where they are at t s, in place; the noise of the motion stays open."""
        self._accumulate(t)
        self._predict()

    def falls_silent(self, t: float) -> bool:
        """Return whether what odometry said last is over before t s, and was not yet at the last record."""
        if self.holds_until == np.inf:
            self.holds_until = t + self._noise.hold_s
        return not self.silent and t > self.holds_until

    def _accumulate(self, t: float) -> None:
        if self.silent:
            self._outage.widen(self.speed, self._yaw_rate, t - self.time)
        else:
            self.travel.add(self.speed, self._yaw_rate, t - self.time)
        self.time = t

    def _predict(self) -> None:
        travel = self.travel
        predict(self._particles, travel, self._noise, self._rng)
        self._hindsight.predict(travel)
        self.way += abs(travel.distance)
        self.pose = advance(self.pose, travel.distance, travel.turn)
        self.travel = Travel()
