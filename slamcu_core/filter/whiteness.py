"""How much of a sensor's noise is new in each frame: what the map's features show between two frames.

Errors of neighbouring frames may be correlated, and what is correlated does not average out. How much is, the sensor
shows: what a feature's measurement changes by from one frame to the next, beyond what odometry explains, has a variance
of 2 R (1 - ρ). Nothing else enters that is unknown, neither the pose nor the map's error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.detections import Instant
from slamcu_core.geometry import rotation, wrap_angle
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]

_PAIRS = 30.0  # of frames, that the assumption one sets out with is worth
_OUTLIER = 9.0  # chi-square with 1 degree of freedom; a wrong association says no more than this


class Whiteness:
    """What consecutive frames of one sensor have shown of 1 - ρ, of both components of its measurements."""

    def __init__(self, model: SensorModel, correlation_time_s: float) -> None:
        self._model, self._time = model, correlation_time_s
        self._pairs = 0
        self._changed = np.zeros(2)  # Σ d² / (R + R'), whose mean is 1 - ρ
        self._features: list[int] = []  # of the map, seen in the last frame ...
        self._measurement = self._noise = np.zeros((2, 0))  # ... and how
        self._reckoned = np.zeros(3)
        self._t = -np.inf

    def fresh(self, share: float) -> float:
        """Return which share of what a frame measures is its own, at least the `share` that is assumed.

        The mean of n values of a first-order Gauss-Markov sequence is worth n (1 - ρ) / (1 + ρ) independent ones.
        """
        assumed = 2.0 * share / (1.0 + share)
        new = min((_PAIRS * assumed + min(self._changed.tolist())) / (_PAIRS + self._pairs), 1.0)
        return max(new / (2.0 - new), share)

    def learn(self, now: Instant, features: list[int], places: Array, measurement: Array, noise: Array) -> None:
        """Learn from A features of the map at places (2, A), measured (2, A) with variances `noise` (2, A)."""
        if now.t - self._t < self._time:
            last = {feature: index for index, feature in enumerate(self._features)}
            here = [index for index, feature in enumerate(features) if feature in last]
            if here:
                before = [last[features[index]] for index in here]
                poses = np.array([now.pose, self._earlier(now)]).T[:, :, None]
                shown, shown_before = self._model.predict(poses, places.take(here, axis=1)[:, None]).swapaxes(0, 1)
                change = measurement.take(here, axis=1) - shown
                change -= self._measurement.take(before, axis=1) - shown_before
                if self._model.has_bearing:
                    change[1] = wrap_angle(change[1])
                square = change * change
                square /= noise.take(here, axis=1) + self._noise.take(before, axis=1)
                self._changed += np.add.reduce(np.minimum(square, _OUTLIER), axis=1)
                self._pairs += len(here)
        self._features, self._measurement, self._noise = features, measurement, noise
        self._reckoned, self._t = now.reckoned, now.t

    def _earlier(self, now: Instant) -> Array:
        """Return where the pose (3,) of now says that the last frame was taken, by dead reckoning between the two."""
        turn = now.pose[2] - now.reckoned[2]
        earlier = np.empty(3)
        earlier[:2] = now.pose[:2] + rotation(float(turn)) @ (self._reckoned[:2] - now.reckoned[:2])
        earlier[2] = self._reckoned[2] + turn
        return earlier
