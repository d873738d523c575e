"""Things that ride along: signs painted on lorries, and whatever else keeps its distance while we drive.

Each detection is compared with those of the same kind a little way back on the road. If it stands where they stood as
seen from the car, it moves with traffic; if it stands where they stood on the road, it does not. The majority decides.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.frame_update import Seen
from slamcu_core.models import SensorModel

_BACK_M = (12.0, 60.0)  # how far back on the road: far enough to tell the two apart, near enough to be the same thing
_VOTES = 3  # earlier detections that must agree


class Riders:
    """Remembers recent detections relative to the car."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float, float, float, int, int]] = deque(maxlen=400)

    def flag(self, model: SensorModel, seen: Seen, odometer: float) -> NDArray[np.bool_]:
        """Return which of D detections ride along, (D,), and remember them; `odometer` is the way driven in m."""
        while self._recent and self._recent[0][0] < odometer - _BACK_M[1]:
            self._recent.popleft()
        first, second = seen.measurement[:, 0], seen.measurement[:, 1]
        ahead = first * np.cos(second) if model.has_bearing else first
        left = first * np.sin(second) if model.has_bearing else second
        std = np.sqrt(seen.noise[:, 0])
        riding = np.zeros(len(first), dtype=bool)
        if self._recent and self._recent[0][0] < odometer - _BACK_M[0]:
            past = np.array(self._recent)
            for index in range(len(first)):
                same = (past[:, 4] == seen.feature_class[index]) & (past[:, 5] == seen.sign[index])
                old = past[same & (past[:, 0] < odometer - _BACK_M[0])]
                slack = 1.5 * np.hypot(old[:, 3], std[index])
                beside = np.abs(old[:, 2] - left[index]) < 3.0
                still = np.abs(old[:, 1] - (odometer - old[:, 0]) - ahead[index]) < slack
                along = (np.abs(old[:, 1] - ahead[index]) < slack) & beside
                riding[index] = along.sum() >= _VOTES and along.sum() > still.sum()
        self._recent.extend(
            (odometer, *item)
            for item in zip(
                ahead.tolist(),
                left.tolist(),
                std.tolist(),
                seen.feature_class.tolist(),
                seen.sign.tolist(),
                strict=True,
            )
        )
        return riding
