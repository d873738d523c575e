"""Things that ride along: signs painted on lorries, and whatever else keeps its distance while we drive.

Each detection is compared with those of the same kind a little way back on the road. If it stands where they stood as
seen from the car, it moves with traffic; if it stands where they stood on the road, it does not. A clear majority
decides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.detections import Seen

Array = NDArray[np.float64]

_BACK_M = (12.0, 60.0)  # how far back on the road: far enough to tell the two apart, near enough to be the same thing
_SLACK = 1.5  # standard deviations that the ranges of one thing may differ by
_VOTES = 3  # earlier detections that must agree
_AGAINST = 4  # and so many times as many as speak for standing still: signs in a row stand where the last one stood
_MOST = 400  # detections remembered


class Riders:
    """Remembers recent detections relative to the car."""

    def __init__(self) -> None:
        self._recent = np.zeros((5, 2 * _MOST))  # odometer, ahead, left, slack², kind
        self._begin = self._end = 0  # of the columns in use

    def flag(self, seen: Seen, odometer: float) -> NDArray[np.bool_]:
        """Return which of D detections ride along, (D,), and remember them; `odometer` is the way driven in m."""
        now = np.empty((5, len(seen.weight)))
        now[0] = odometer
        now[1:3] = seen.ahead_left
        np.multiply(seen.noise[0], _SLACK**2, out=now[3])
        now[4] = (seen.feature_class * 4096 + seen.sign) * 4096 + seen.value
        driven = self._recent[0, self._begin : self._end]
        self._begin += int(driven.searchsorted(odometer - _BACK_M[1]))
        old = self._recent[:, self._begin : self._end]
        old = old[:, : int(old[0].searchsorted(odometer - _BACK_M[0]))]
        riding = _ride(now, old) if old.shape[1] else np.zeros(now.shape[1], dtype=bool)
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
    driven = now[0, 0]  # the same for all
    ahead, left, slack, kind = now[1, :, None], now[2, :, None], now[3, :, None], now[4, :, None]
    aside = old[2] - left
    np.abs(aside, out=aside)
    along = aside < 3.0
    closer = old[1] - ahead
    room = np.add(slack, old[3], out=aside)
    along &= closer * closer < room
    same = kind == old[4]
    along &= same
    votes = np.add.reduce(along, axis=1, dtype=np.intp)
    riding = votes >= _VOTES
    if np.count_nonzero(riding):
        closer -= driven - old[0]
        closer *= closer
        still = closer < room
        still &= same
        riding &= votes > _AGAINST * np.add.reduce(still, axis=1, dtype=np.intp)
    return np.asarray(riding)
