"""What is constantly wrong given a particle's path, by scalar Kalman filters: GNSS bias and sensor calibration."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.resampling import systematic
from slamcu_core.geometry import mahalanobis_square
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]

_FAR: Final = 50.0  # normalised innovation squared, chi-square with 2 degrees of freedom: once in 7e10 fixes
ASIDE_M2: Final = 0.25  # m², of what fixes are aside for good: the antenna is not on the axle, nor the datum the map's


class GnssBias:
    """A receiver's error as a slowly wandering bias (first order Gauss-Markov) plus white noise.

    Given a particle's path the bias is Gaussian; its variance is the same for all particles.
    """

    def __init__(self, parameters: FilterParameters, start_std: float) -> None:
        self._parameters = parameters
        self._start_variance = start_std**2
        self._variance: float | None = None
        self._time = 0.0
        self.age = 0.0  # s for which the bias has been predicted
        self.stationary = 0.0  # variance of the bias when nothing is known of it, by the last fix, m²

    @property
    def variance(self) -> float:
        """Variance of the bias given a path, of each axis, m²; 0 before the first fix."""
        return self._variance or 0.0

    def keep(self, time: float) -> float:
        """Return what share of the bias is left after a time (s)."""
        return math.exp(-time / max(self._parameters.gnss_correlation_s, 1e-3))

    def _begin(self, particles: Particles, stationary: float) -> float:
        """Set out from what the start says of the bias, in place, and return the bias's variance.

        Where a drive starts is mostly known from the same receiver, with the same bias: the first fixes then tell
        nothing that the start did not. So the start's error and the bias are taken to share all that they can.
        """
        shared = min(self._start_variance, stationary)
        share = shared / self._start_variance if self._start_variance > 0.0 else 0.0
        particles.gnss_bias *= share
        return stationary - share * shared

    def update(self, particles: Particles, t: float, fix: Array, std_m: float) -> bool:
        """Weigh particles by a fix (2,) in metres with standard deviation `std_m` and update their biases, in place.

        The weight has the tails of Student's t with 4 degrees of freedom, so that a reflected fix does little harm; one
        that is far beyond what the particles and their bias allow changes nothing. Return whether it was refused so.
        """
        variance, total = self._predict(particles, t, std_m)
        innovation = fix[:, None] - particles.state[:2] - particles.gnss_bias
        if not self._square(innovation, particles.weights, total) <= _FAR:  # nor one that is no number
            return True
        far = np.log1p(np.sum(innovation**2, axis=0) / (4.0 * total))
        particles.log_weight = particles.log_weight - 3.0 * far
        self._learn(particles, innovation, variance, total)
        return False

    def place(self, particles: Particles, t: float, fix: Array, std_m: float, rng: np.random.Generator) -> bool:
        """Draw the particles' places from a fix (2,), m, which their own spread tells nothing beside, in place.

        Each takes what it knows of the receiver's bias into account. One far beyond all of them changes nothing; return
        whether it was refused so.
        """
        if self._variance is None:
            self._start_variance = 0.0  # what the start shares with the first fix is over
        variance, total = self._predict(particles, t, std_m)
        innovation = fix[:, None] - particles.state[:2] - particles.gnss_bias
        if not self._square(innovation, particles.weights, total) <= _FAR:
            return True
        error = math.sqrt(total) * rng.standard_normal((2, len(particles)))
        particles.state[:2] = fix[:, None] - particles.gnss_bias - error
        self._learn(particles, error, variance, total)
        return False

    def _predict(self, particles: Particles, t: float, std_m: float) -> tuple[float, float]:
        """Let the bias wander until t s, in place, and return its variance, and that of a fix, m²."""
        white = (self._parameters.gnss_white_share * std_m) ** 2
        self.stationary = std_m**2 - white
        if self._variance is None:
            self._variance = self._begin(particles, self.stationary)
        else:
            self.age += t - self._time
            keep = self.keep(t - self._time)
            particles.gnss_bias *= keep
            self._variance = keep**2 * self._variance + (1.0 - keep**2) * self.stationary
        self._time = t
        return self._variance, self._variance + white

    def _learn(self, particles: Particles, innovation: Array, variance: float, total: float) -> None:
        """Learn the bias from innovations (2, M), each of the variance `total`, in place."""
        gain = variance / total
        particles.gnss_bias += gain * innovation
        self._variance = variance * (1.0 - gain)

    @staticmethod
    def _square(innovation: Array, weights: Array, variance: float) -> float:
        """Return the normalised square of innovations (2, M), each of a variance of its own, over the particles."""
        mean = innovation @ weights
        delta = innovation - mean[:, None]
        xx, xy, _, yy = ((delta * weights) @ delta.T).ravel()
        own = variance + ASIDE_M2
        return float(mahalanobis_square(mean, np.array([xx + own, xy, yy + own]))[0])

    def start_over(self, particles: Particles, fix: Array, std_m: float, rng: np.random.Generator) -> None:
        """Spread particles about the last fix (2,), m, as if the drive started there, in place; headings stay."""
        particles.select(systematic(particles.weights, rng))
        particles.restart(fix, particles.state[2], std_m, 0.0, rng)
        particles.gnss_bias = fix[:, None] - particles.state[:2]
        self._start_variance = std_m**2
        self._variance = self._begin(particles, self.stationary)


class Calibrations:
    """Range scale error and bearing bias of each of a vehicle's S sensors, learned from features of the map.

    The means are per particle (`Particles.calibration`), the variances (2 S,) common to all: of each sensor the scale,
    then the bias.
    """

    def __init__(self, parameters: FilterParameters, sensors: int = 1) -> None:
        self.stationary = np.array([parameters.range_scale_std**2, parameters.bearing_bias_std**2] * sensors)
        self._time_constant = parameters.calibration_time_s
        self.variance = self.stationary.copy()
        self.age = 0.0  # s for which the calibrations have been predicted

    def keep(self, time: float) -> float:
        """Return what share of a calibration is left after a time (s)."""
        return math.exp(-time / self._time_constant)

    def predict(self, particles: Particles, dt: float) -> None:
        """Let the calibrations wander for `dt` seconds, in place."""
        self.age += dt
        keep = self.keep(dt)
        particles.calibration *= keep
        self.variance = keep**2 * self.variance + (1.0 - keep**2) * self.stationary

    @property
    def vaguest(self) -> tuple[float, float]:
        """The largest variances of a scale and of a bias, for what more than one sensor may have seen."""
        scale, turn = self.variance.reshape(-1, 2).max(axis=0).tolist()
        return scale, turn


class SensorCalibration:
    """The calibration of the sensor of a number among those of a vehicle."""

    def __init__(self, of_all: Calibrations, number: int = 0) -> None:
        self._of_all, self._number = of_all, number
        self._part = slice(2 * number, 2 * number + 2)

    @property
    def variance(self) -> Array:
        """Variances (2,) of range scale error and bearing bias."""
        return self._of_all.variance[self._part]

    def means(self, particles: Particles) -> Array:
        """Return what each particle has for range scale error and bearing bias, (2, M)."""
        return particles.calibration[self._part]

    def beyond_the_first(self, particles: Particles) -> tuple[float, float]:
        """Return by how much this sensor stretches (of the range) and turns (rad) more than the vehicle's first."""
        if not self._number:
            return 0.0, 0.0
        scale, turn = (self.means(particles) @ particles.weights).tolist()
        first_scale, first_turn = (particles.calibration[:2] @ particles.weights).tolist()
        return scale / (1.0 + scale) - first_scale / (1.0 + first_scale), turn - first_turn

    def update(self, particles: Particles, innovation: Array, distance: Array, noise: Array) -> None:
        """Learn from A features of the map, in place.

        Parameters
        ----------
        innovation : (2, A, M) z - ẑ of each particle, the calibration so far included in ẑ.
        distance : (A,) true range, averaged over the particles, m.
        noise : (2, A) variances of the measurement and of the map's place, already tempered.
        """
        # one scalar Kalman filter each for scale and turn: to take all A at once gives what one after the other would
        towards = np.empty((2, len(distance)))  # ∂z/∂(scale, turn)
        towards[0], towards[1] = distance, 1.0
        gain = towards / noise
        information = np.vecdot(towards, gain)
        variance = self.variance / (1.0 + self.variance * information)
        self._of_all.variance[self._part] = variance
        gain *= variance[:, None]
        particles.calibration[self._part] += np.matmul(gain[:, None], innovation)[:, 0]


class Instrument(NamedTuple):
    """A sensor: how it measures, and what has been learned of its errors."""

    model: SensorModel
    calibration: SensorCalibration
