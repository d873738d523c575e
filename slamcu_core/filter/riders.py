"""Things that ride along: signs painted on lorries, and whatever else keeps its distance while we drive.

Each detection is compared with those of the same kind a little way back on the road. If it stands where they stood as
seen from the car, it moves with traffic; if it stands where they stood on the road, it does not. The majority decides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.view import Seen
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]

_BACK_M = (12.0, 60.0)  # how far back on the road: far enough to tell the two apart, near enough to be the same thing
_VOTES = 3  # earlier detections that must agree
_MOST = 400  # detections remembered


class Riders:
    """Remembers recent detections relative to the car."""

    def __init__(self) -> None:
        self._recent = np.zeros((5, 2 * _MOST))  # odometer, ahead, left, variance of range, kind
        self._begin = self._end = 0  # of the columns in use

    def flag(self, model: SensorModel, seen: Seen, odometer: float) -> NDArray[np.bool_]:
        """Return which of D detections ride along, (D,), and remember them; `odometer` is the way driven in m."""
        first, second = seen.measurement
        now = np.empty((5, len(first)))
        now[0] = odometer
        now[1] = first * np.cos(second) if model.has_bearing else first
        now[2] = first * np.sin(second) if model.has_bearing else second
        now[3] = seen.noise[0]
        now[4] = seen.feature_class * 1e6 + seen.sign
        driven = self._recent[0, self._begin : self._end]
        self._begin += int(driven.searchsorted(odometer - _BACK_M[1]))
        old = self._recent[:, self._begin : self._end]
        old = old[:, : int(old[0].searchsorted(odometer - _BACK_M[0]))]
        riding = _ride(now, old) if old.shape[1] else np.zeros(len(first), dtype=bool)
        self._remember(now)
        return riding

    def _remember(self, now: Array) -> None:
        count = now.shape[1]
        if self._end + count > self._recent.shape[1]:
            kept = self._recent[:, self._begin : self._end].copy()
            self._begin, self._end = 0, kept.shape[1]
            self._recent = np.concatenate([kept, np.zeros((5, 2 * _MOST + count))], axis=1)
        self._recent[:, self._end : self._end + count] = now
        self._end += count
        self._begin = max(self._begin, self._end - _MOST)


def _ride(now: Array, old: Array) -> NDArray[np.bool_]:
    """Return which of the detections `now` (5, D) ride along, by those a little way back, `old` (5, P)."""
    driven, ahead, left, variance, kind = now[:, :, None]
    slack = (1.5**2) * (variance + old[3])
    same = kind == old[4]
    closer = old[1] - ahead
    along = same & (closer * closer < slack) & (np.abs(old[2] - left) < 3.0)
    votes = np.count_nonzero(along, axis=1)
    riding = votes >= _VOTES
    if riding.any():
        closer -= driven - old[0]
        riding &= votes > np.count_nonzero(same & (closer * closer < slack), axis=1)
    return np.asarray(riding)
