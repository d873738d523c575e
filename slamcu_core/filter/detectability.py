"""How often a sensor detects what it has in view, by range: learned on the way from what has proven to stand there.

The header's detection probability is one number; cameras see near things in most frames and far ones in few. Taken at
its word far away, it makes Deleted out of things that are merely hard to see.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BINS = 8  # of equal width up to the sensor's reach
_PRIOR_LOOKS = 8.0  # that the header's figure counts for in each


class DetectionRate:
    """The detection probability of one sensor: the mean of a Beta distribution in each bin of range."""

    def __init__(self, nominal: float, reach_m: float) -> None:
        self._width = reach_m / _BINS
        self._hits = np.full(_BINS, _PRIOR_LOOKS * nominal)
        self._looks = np.full(_BINS, _PRIOR_LOOKS)

    def at(self, distance: Array) -> Array:
        """Return the probability of a detection (F,) at ranges (F,) in m."""
        return np.asarray((self._hits / self._looks)[self._bin(distance)])

    def learn(self, distance: Array, hit: NDArray[np.bool_], share: float) -> None:
        """Add looks at things in full view, at ranges (K,) in m, of which some were detected, (K,).

        `share` of such a look is a look of its own.
        """
        bins = self._bin(distance)
        self._looks += share * np.bincount(bins, minlength=_BINS)
        self._hits += share * np.bincount(bins[hit], minlength=_BINS)

    def _bin(self, distance: Array) -> NDArray[np.intp]:
        return np.minimum(distance / self._width, _BINS - 1).astype(np.intp)
