"""How far the filter trusts itself: innovations, unexplained detections and missing ones against their expectation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcu_core.reports import Health

Array = NDArray[np.float64]

_MEMORY = 30.0  # looks over which the statistics are averaged
_WINDOW_S = 20.0  # s; time in which what was seen of a thing is forgotten
_DUE = 1.5  # detections that a feature of the map should have brought, before it is missing
_SEEN = 0.5  # detections that it takes to have been seen
# ln of how much likelier each is with the right pose than with a wrong one: nine in ten things that the map promises
# are there, with a wrong pose a quarter by chance; half of what is found would be found there too
_KEPT, _MISSING, _FOUND = 1.3, -2.0, -0.6
_DOUBT = -3.0  # ln of the odds of the right pose below which a better one is looked for ...
_LOST = -5.0  # ... and below which reports are not to be believed


class HealthMonitor:
    """Running statistics of one drive, in independent looks (tempered frames)."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past, after the filter has found its way back."""
        self._innovation = self._matched = 0.0
        self._unexplained = self._detections = 0.0
        self._t = 0.0
        self._due, self._seen = np.zeros(64), np.zeros(64)  # by row, detections lately: expected and made
        self._mapped = np.zeros(64, dtype=bool)

    def observe(
        self, squares: list[float], detections: int, unexplained: int, *, expected: float, share: float
    ) -> None:
        """Add one frame.

        Parameters
        ----------
        squares : normalised innovations squared of detections matched with features of the map.
        detections, unexplained : how many detections there were, and how many fitted nothing.
        expected : sum of the probabilities with which the features of the map, whatever has become of them, should
            have shown themselves.
        share : of the frame's evidence that is its own.
        """
        keep = max(0.0, 1.0 - share * (detections + expected) / _MEMORY)
        self._innovation = keep * self._innovation + share * sum(squares)
        self._matched = keep * self._matched + share * len(squares)
        self._unexplained = keep * self._unexplained + share * unexplained
        self._detections = keep * self._detections + share * detections

    def note(self, t: float, rows: NDArray[np.intp], mapped: NDArray[np.bool_], due: Array, hit: Array) -> None:
        """Note of rows (F,) in view at t s which are the map's, and how many detections were due and were made."""
        keep = math.exp(-max(t - self._t, 0.0) / _WINDOW_S)
        self._t = t
        if len(rows) and rows.max() >= len(self._due):
            more = int(rows.max()) + 64
            self._due, self._seen = (np.concatenate([a, np.zeros(more - len(a))]) for a in (self._due, self._seen))
            self._mapped = np.concatenate([self._mapped, np.zeros(more - len(self._mapped), dtype=bool)])
        self._due *= keep
        self._seen *= keep
        self._due[rows] += due
        self._seen[rows] += hit
        self._mapped[rows] = mapped

    def _odds(self) -> float:
        """Return ln of the odds that the pose is right, by the things that were or should have been seen lately.

        Each counts once, however long it was looked at: one hidden sign is no more than that.
        """
        seen = self._seen > _SEEN
        missing = self._mapped & ~seen & (self._due > _DUE)
        kept, found = np.count_nonzero(self._mapped & seen), np.count_nonzero(~self._mapped & seen)
        return _KEPT * kept + _MISSING * int(np.count_nonzero(missing)) + _FOUND * found

    @property
    def doubtful(self) -> bool:
        """Whether there is reason to look for a better pose."""
        return self._odds() < _DOUBT

    @property
    def lost(self) -> bool:
        """Whether reports are not to be believed."""
        return self._odds() < _LOST

    def state(self, effective_share: float) -> Health:
        """Return the health of the moment; `effective_share` is M_eff / M."""
        return Health(
            trusted=not self.lost,
            effective_particles=min(1.0, effective_share),
            innovation_ratio=self._innovation / (2.0 * self._matched) if self._matched > 0.0 else 1.0,
            unexplained_ratio=min(1.0, self._unexplained / self._detections) if self._detections > 0.0 else 0.0,
        )
