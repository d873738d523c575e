"""What was found and left behind follows what is learnt of the pose later: a fixed-point smoother.

A find is no better placed than the pose was when it was seen, and half a kilometre on a sign of the map tells how
wrong that was. To draw such finds with the particles would have chance choose among paths of long ago. So a find that
was left behind is a Gaussian, and so is its covariance with the state kept: pose, constants of the vehicle, bias of the
receiver, calibration of the sensor. Between two resamplings the state is predicted as a Gaussian; what the measurements
have then made of it is what the particles say, and that moves the find by its regression on the state (Rauch, Tung and
Striebel 1965).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.calibration import Calibrations, GnssBias
from slamcu_core.filter.ekf import full
from slamcu_core.filter.moving import rotation_by
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.prediction import Travel, linearized
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.geometry import wrap_angle
from slamcu_core.models import MotionNoise

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_BEHIND_M = 90.0  # beyond the sensors' reach; nearer than 60 m, finds are looked up for the particles
_MOST = 64  # finds that follow; beyond, the oldest stay where they are
_RIDGE = 1e-6  # on correlations of the state
_LEAST_M2 = 1e-4  # m²; least variance of a place
_BIAS, _SENSORS = slice(6, 8), slice(8, None)  # of the state, whose first six are sampled


class Hindsight:
    """The finds of one drive that are too far behind for sensors of a `reach` (m), and still get better placed."""

    def __init__(
        self,
        table: FeatureTable,
        particles: Particles,
        *,
        gnss: GnssBias,
        calibrations: Calibrations,
        motion: MotionNoise,
        reach: float,
    ) -> None:
        self._table, self._particles, self._motion = table, particles, motion
        self._beyond = reach + _BEHIND_M
        self._gnss, self._calibrations = gnss, calibrations
        size = 8 + len(calibrations.variance)
        self._rows: Index = np.zeros(0, dtype=np.intp)
        self._born: Array = np.zeros(0)  # of the finds, for a row may be another's by now
        self._cross: Array = np.zeros((0, 2, size))  # covariance of each place with the state
        self._mean: Array = np.zeros(size)  # of the state, predicted since the last resampling
        self._covariance: Array = np.zeros((size, size))
        self._travel = Travel()  # not in that yet
        self._unlearnt: Array = np.zeros(size - 8)  # variance of the calibrations in that
        self._ages = 0.0, 0.0  # of the receiver's bias and the calibration at that resampling, s

    def follows(self, rows: Index) -> NDArray[np.bool_]:
        """Return which of the rows (A,) follow."""
        self._drop_the_gone()
        return np.isin(rows, self._rows)

    def predict(self, travel: Travel) -> None:
        """Note how the particles were predicted; the state follows when that has become some way."""
        if not len(self._rows):
            return
        self._travel.distance += travel.distance
        self._travel.turn += travel.turn
        self._travel.time += travel.time
        if self._travel.full:
            self._predict()

    def _predict(self) -> None:
        """Predict the state by the way noted since the last time."""
        if self._travel.time > 0.0:
            self._mean[:6], by_state, noise = linearized(self._mean[:6], self._travel, self._motion)
            self._covariance[:6] = by_state @ self._covariance[:6]
            self._covariance[:, :6] = self._covariance[:, :6] @ by_state.T
            self._covariance[:6, :6] += noise
            self._cross[:, :, :6] = self._cross[:, :, :6] @ by_state.T
        self._travel = Travel()

    def let_go(self) -> None:
        """Leave all finds where they are: what is learnt from now on of the pose says nothing of what it was."""
        self._rows, self._born, self._cross = self._rows[:0], self._born[:0], self._cross[:0]
        self._travel = Travel()

    def learn(self) -> None:
        """Let the finds follow what the particles, just resampled, have learnt, and take in more of them."""
        self._drop_the_gone()
        more = self._left_behind()
        if not len(self._rows) and not len(more):
            return
        self._predict()
        mean, covariance, spread = self._state()
        if len(self._rows):
            self._wander()
            gain = _regression(self._cross, self._covariance)
            learnt = mean - self._mean
            learnt[2] = wrap_angle(float(learnt[2]))
            change = covariance - self._covariance
            # what is not known of the calibration is added where a place is told, as it is known then
            change[_SENSORS, _SENSORS] -= np.diag(self._calibrations.variance - self._unlearnt)
            table, rows = self._table, self._rows
            table.xy[rows] += gain @ learnt
            table.covariance[rows] += (gain @ change @ gain.swapaxes(1, 2)).reshape(-1, 4)[:, [0, 1, 3]]
            self._cross = gain @ covariance
        self._mean, self._covariance = mean, covariance
        self._ages = self._gnss.age, self._calibrations.age
        self._unlearnt = self._calibrations.variance.copy()
        if len(more):
            self._take_in(more, spread)

    def recall(self, row: int, slot: int) -> None:
        """Give a find that comes near again back to the particles, each of which has it where its own state says."""
        self._predict()
        particles, table = self._particles, self._table
        place, covariance = table.xy[row], full(table.covariance[row])
        here = np.zeros((2, len(particles)))
        for cross in self._cross[self._rows == row, :, :8]:
            known, spread = self._state()[1:]
            gain = _regression(cross, known[:8, :8])
            here = gain @ spread[:8]
            covariance = covariance - gain @ known[:8, :8] @ gain.T
        size, axes = np.linalg.eigh(covariance)
        covariance = (axes * np.maximum(size, _LEAST_M2)) @ axes.T
        particles.means[:, slot] = place[:, None] + here
        particles.covariances[:, slot] = covariance.ravel()[[0, 1, 3], None]
        table.slot[row] = slot

    def move(self, to: Callable[[Array], Array], turn: float) -> None:
        """Go over to another frame by a function of places (2,), where everything is turned by `turn` (rad)."""
        rotation = rotation_by(turn)
        by_state = np.eye(len(self._mean))
        by_state[:2, :2] = by_state[_BIAS, _BIAS] = rotation
        self._mean[:2] = to(self._mean[:2])
        self._mean[2] += turn
        self._mean[_BIAS] = rotation @ self._mean[_BIAS]
        self._covariance = by_state @ self._covariance @ by_state.T
        self._cross = rotation @ self._cross @ by_state.T

    def _state(self) -> tuple[Array, Array, Array]:
        """Return mean (S,) and covariance (S, S) of the state, and what each particle differs from it, (S, M)."""
        particles = self._particles
        weights = particles.weights
        state = np.concatenate([particles.state, particles.gnss_bias, particles.calibration])
        mean = state @ weights
        mean[:6], covariance = particles.mean_state()
        spread = state - mean[:, None]
        spread[2] = wrap_angle(spread[2])
        whole = (spread * weights) @ spread.T
        whole[:6, :6] = covariance
        whole[_BIAS, _BIAS] += self._gnss.variance * np.eye(2)
        whole[_SENSORS, _SENSORS] += np.diag(self._calibrations.variance)
        return mean, whole, spread

    def _wander(self) -> None:
        """Predict what changes by itself: the receiver's bias and the calibration."""
        gnss = self._gnss.keep(self._gnss.age - self._ages[0])
        calibration = self._calibrations.keep(self._calibrations.age - self._ages[1])
        keep = np.ones(len(self._mean))
        keep[_BIAS], keep[_SENSORS] = gnss, calibration
        self._mean *= keep
        self._cross *= keep
        self._covariance *= np.outer(keep, keep)
        self._covariance[_BIAS, _BIAS] += (1.0 - gnss**2) * self._gnss.stationary * np.eye(2)
        anew = (1.0 - calibration**2) * self._calibrations.stationary
        self._covariance[_SENSORS, _SENSORS] += np.diag(anew)
        self._unlearnt = calibration**2 * self._unlearnt + anew

    def _left_behind(self) -> Index:
        """Return the rows of finds that the particles still place and need not."""
        table = self._table
        own = ((table.slot >= 0) & (table.kind == Kind.NEW)).nonzero()[0]
        here = self._particles.state[:2, 0]  # any particle will do
        return np.asarray(own[np.hypot(*(table.xy[own] - here).T) > self._beyond])

    def _take_in(self, own: Index, spread: Array) -> None:
        """Take finds from the particles, whose states differ by (S, M) from their mean."""
        table, particles = self._table, self._particles
        slots = table.slot[own]
        place, covariance = particles.collapse(slots)
        cross = np.einsum("akm,sm->kas", particles.means[:, slots] - place[:, :, None], spread * particles.weights)
        # what is not known of the calibration turns and stretches the line of sight in all particles alike
        seen_from = table.view_from[own] / np.maximum(table.view_weight[own], 1e-300)[:, None]
        x, y = np.where(table.view_weight[own] > 0.0, (place.T - seen_from).T, 0.0)
        variance = self._calibrations.variance / (0.5 * len(self._calibrations.variance))  # each saw as much of it
        cross[:, :, 8::2] -= np.stack([x, y], axis=1)[:, :, None] * variance[::2]
        cross[:, :, 9::2] -= np.stack([-y, x], axis=1)[:, :, None] * variance[1::2]
        table.xy[own], table.covariance[own], table.slot[own] = place.T, covariance.T, -1
        self._rows = np.concatenate([self._rows, own])[-_MOST:]
        self._born = np.concatenate([self._born, table.born[own]])[-_MOST:]
        self._cross = np.concatenate([self._cross, cross])[-_MOST:]

    def _drop_the_gone(self) -> None:
        """Forget rows that are no longer behind, or no longer of the same find."""
        table, rows = self._table, self._rows
        stays = table.alive[rows] & (table.slot[rows] < 0) & (table.born[rows] == self._born)
        if not stays.all():
            self._rows, self._born, self._cross = rows[stays], self._born[stays], self._cross[stays]


def _regression(cross: Array, covariance: Array) -> Array:
    """Return the regression (..., S) of places on a state, by their covariance with it (..., S) and its own (S, S).

    What of the state is known for certain moves nothing.
    """
    std = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    std[std == 0.0] = 1.0
    correlation = covariance / np.outer(std, std) + _RIDGE * np.eye(len(std))
    by_state = np.linalg.solve(correlation, (cross / std).reshape(-1, len(std)).T).T
    return np.asarray(by_state.reshape(cross.shape) / std)
