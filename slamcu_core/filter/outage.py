"""While the odometer is silent, no motion is assumed: the particles spread as far as the car may have come.

Nobody knows then which way the car went, so the cloud stays about the last known place and its standard deviation is
speed times time. A fix says where the car is, and the way counts anew from there; of the heading it says nothing. From
the moment at which a feature could be looked for in a wrong place until map or fixes have brought the pose back, with
odometry to go on by, it is in doubt, and nothing that is seen or missed is evidence.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.calibration import GnssBias
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.resampling import systematic
from slamcu_core.models import MotionNoise

Array = NDArray[np.float64]

_FARTHEST_M = 10_000.0  # m, standard deviation; farther off no fix is told from an outlier, and the frame is not flat
_ANY_HEADING = math.pi / math.sqrt(3.0)  # rad, standard deviation of a heading of which nothing is known
_ASIDE = 0.125  # of the reach: so far aside things may be expected, in standard deviations, before nobody knows them
_BLUNT = 2.0  # standard deviations of a fix; of particles farther apart few fit it


class Outage:
    """What the silences of the odometer do to the particles of one drive.

    Parameters
    ----------
    particles : changed in place.
    gnss : what is known of the satellite receiver.
    noise : how fast a car may drive and turn of which nothing is told.
    reach : m, of the sensors.
    rng : draws what the particles do.
    """

    def __init__(
        self, particles: Particles, gnss: GnssBias, noise: MotionNoise, *, reach: float, rng: np.random.Generator
    ) -> None:
        self._particles, self._gnss, self._noise, self._rng = particles, gnss, noise, rng
        self._reach = reach
        self._silent = False
        self._way = 0.0  # m, standard deviation of what was driven since the last fix ...
        self._turn = 0.0  # ... and rad, of what was turned since odometry spoke
        self._adrift = False  # whether no fix has come since the particles were spread
        self._placed: Array | None = None  # (2, M) where a fix put them, if odometry has told all since
        self.doubtful = False  # whether the pose is too vague for evidence

    def widen(self, speed: float, yaw_rate: float, time: float) -> None:
        """Spread the particles by `time` s of silence after a speed (m/s) and yaw rate (rad/s), in place."""
        if time <= 0.0:
            return
        particles, noise = self._particles, self._noise
        particles.settle(self._rng)
        way = min(self._way + max(abs(speed), noise.untold_speed) * time, _FARTHEST_M)
        turn = min(self._turn + max(abs(yaw_rate), noise.untold_turn) * time, _ANY_HEADING)
        along, about = math.sqrt(way**2 - self._way**2), math.sqrt(turn**2 - self._turn**2)
        draw = self._rng.standard_normal((3, len(particles)))
        draw -= (draw @ particles.weights)[:, None]  # chance is not to move the mean, a tenth of so much
        particles.state[:3] += np.array([[along], [along], [about]]) * draw
        self._way, self._turn, self._adrift, self._silent = way, turn, True, True
        self._placed = None
        self.doubtful |= self._aside() > _ASIDE * self._reach

    def end(self) -> None:
        """Note that odometry speaks again."""
        self._way = self._turn = 0.0
        self._silent = False

    def take(self, t: float, fix: Array, std_m: float) -> bool:
        """Take a fix (2,), m, of poses that are sampled; return whether it was refused, having changed nothing.

        Where the particles are but spread, it says where they are, and the next one how they are turned: they are drawn
        so, for of particles so far apart hardly any would fit.
        """
        particles = self._particles
        if not (self._adrift or self._placed is not None) or not self._far_apart(std_m):
            refused = self._gnss.update(particles, t, fix, std_m)
            placed = None
        else:
            if self._adrift:
                particles.select(systematic(particles.weights, self._rng))
            reckoned = particles.state[:2].copy()
            refused = self._gnss.place(particles, t, fix, std_m, self._rng)
            placed = particles.state[:2].copy()
            if self._placed is not None and not refused:
                particles.state[2] += _direction(placed - self._placed) - _direction(reckoned - self._placed)
        if not refused:
            self._note_place(placed)
        return refused

    def place_found(self) -> None:
        """Note that the map, or fixes that agree, have told where the car is."""
        self._note_place(None)

    def _note_place(self, placed: Array | None) -> None:
        self._way, self._adrift, self._placed = 0.0, False, placed
        self.look_again()

    def look_again(self) -> None:
        """End the doubt if odometry speaks and the pose is known well enough."""
        if self.doubtful and not self._silent and not self._adrift:
            self.doubtful = self._aside() > _ASIDE * self._reach
        if not self.doubtful:
            self._placed = None

    def _far_apart(self, std_m: float) -> bool:
        """Return whether hardly any particle would fit a fix."""
        spread = self._particles.place_covariance()
        return bool(spread[0] + spread[2] > 2.0 * (_BLUNT * std_m) ** 2)

    def _aside(self) -> float:
        """Return the standard deviation in m with which a thing at the sensors' reach is expected beside its place."""
        covariance = self._particles.mean_state()[1]
        return math.sqrt(covariance[0, 0] + covariance[1, 1] + self._reach**2 * covariance[2, 2])


def _direction(way: Array) -> Array:
    """Return the directions (M,) of ways (2, M), rad."""
    return np.asarray(np.arctan2(way[1], way[0]))
