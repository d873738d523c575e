"""Recovery from a wrong pose, while the filter doubts itself: remember what was seen, search, and start over there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.detections import Instant, Seen
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.relocation import Memory, Motion, Sightings, agreement, same, search
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_MEMORY_S = 20.0  # s; dead reckoning is good for so long
_SEARCH_INTERVAL_S = 2.0  # s between searches while in doubt
_AGREEMENT = 5  # things seen that must fall on the map for a new pose ...
_SHARE = 0.7  # ... and share of all that was seen ...
_BETTER_BY = 3  # ... and so many more than from the old one
_FITS = 0.6  # share of what was seen that fits the map from here, above which no other pose is asked for


class Recovery:
    """Remembers the last sightings and moves the particles to where they fit the map clearly better."""

    def __init__(self, table: FeatureTable, particles: Particles, rng: np.random.Generator) -> None:
        self._table, self._particles, self._rng = table, particles, rng
        self._memory = Memory(_MEMORY_S)
        self._last_search = -np.inf
        self._candidate: Motion | None = None

    def remember(self, model: SensorModel, seen: Seen, now: Instant) -> None:
        """Remember the detections of a frame."""
        if not seen.measurement.shape[1]:
            return
        std = np.sqrt(seen.noise)
        larger = np.maximum(std[0], seen.measurement[0] * std[1]) if model.has_bearing else std[0]
        self._memory.add(Sightings(now.t, now.reckoned, seen.ahead_left, larger, seen.feature_class, seen.sign))

    def forget(self) -> None:
        """Forget what was seen: from now on it is not known how the car moved meanwhile."""
        self._memory.clear()
        self._candidate = None

    def find_the_way_back(self, now: Instant, around: Index, *, anywhere: bool = False) -> Array | None:
        """Move the particles to where the last sightings fit the active rows of the map, if they fit clearly better.

        Or if they fit at all, where the car may be `anywhere`. Return where that is (2,), m; None if they were left
        where they are.
        """
        if now.t - self._last_search <= _SEARCH_INTERVAL_S:
            return None
        self._last_search = now.t
        table, particles, reckoned = self._table, self._particles, now.reckoned
        rows = around[table.kind[around] == Kind.MAP]
        seen = self._memory.constellation()
        if len(seen.place) < _AGREEMENT or len(rows) < _AGREEMENT:
            return None
        fits = seen.fits(table.feature_class[rows], table.sign[rows])
        mean, _ = particles.mean_state()
        here = Motion.between(reckoned, mean)
        before, self._candidate = self._candidate, None
        explained = 0 if anywhere else agreement(seen, here, table.xy[rows], fits)
        if explained > _FITS * len(seen.place):
            return None  # in a crowd a search costs hundreds of steps
        motion, agreed, rival = search(seen, table.xy[rows], fits)
        needed = max(_AGREEMENT, _SHARE * len(seen.place), explained + _BETTER_BY, rival + 1)
        if motion is None or agreed < needed or (not anywhere and same(motion, here, reckoned[:2])):
            return None
        if before is None or not same(motion, before, reckoned[:2]):
            self._candidate = motion
            return None  # let the next search say it again: chance agreements do not last
        std = float(seen.std.mean())
        spread = float(np.hypot(*seen.place.std(axis=0)))
        place = motion.apply(reckoned[:2])
        particles.restart(place, motion.angle + reckoned[2], std, std / max(spread, std), self._rng)
        self._memory.clear()
        return place
