"""How often a sensor detects what it has in view, by range: learned on the way from what has proven to stand there.

The header's detection probability is one number; cameras see near things in most frames and far ones in few. Taken at
its word far away, it makes Deleted out of things that are merely hard to see.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_BINS = 8  # of equal width up to the sensor's reach
_PRIOR_LOOKS = 8.0  # that the header's figure counts for in each


class DetectionRate:
    """The detection probability of one sensor: the mean of a Beta distribution in each bin of range."""

    def __init__(self, nominal: float, reach_m: float) -> None:
        self._width = reach_m / _BINS
        self._hits = np.full(_BINS, _PRIOR_LOOKS * nominal)
        self._looks = np.full(_BINS, _PRIOR_LOOKS)

    def within(self, distance: Array) -> RatesInView:
        """Return the rates of things at ranges (F,) in m."""
        bins = np.minimum(distance / self._width, _BINS - 1).astype(np.intp)
        return RatesInView(self._hits, self._looks, bins)


class RatesInView(NamedTuple):
    """The rates of F things, of which it has been asked once in which bins of range they are."""

    hits: Array  # of each bin, as in the sensor's rate
    looks: Array
    bins: Index  # (F,)

    def now(self) -> Array:
        """Return the probability of a detection of each (F,)."""
        return np.asarray((self.hits / self.looks)[self.bins])

    def learn(self, which: NDArray[np.bool_], hit: NDArray[np.bool_], share: float) -> None:
        """Add looks at those in full view, `which` (F,), of which those `hit` (F,) were detected, for all that come.

        `share` of such a look is a look of its own.
        """
        looked_at = self.bins[which]
        self.looks[:] += share * np.bincount(looked_at, minlength=_BINS)
        self.hits[:] += share * np.bincount(looked_at[hit[which]], minlength=_BINS)
