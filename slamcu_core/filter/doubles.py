"""Doubles: finds that stand as missed features of the map do, but for one motion, are those, seen from a wrong pose.

A car that has come off its way a little finds things beside where the map has them and believes those of the map gone.
From then on it goes by its finds, and nothing speaks against its pose any more. That several things were taken away and
as many put up in the same arrangement is far less likely than one wrong pose.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import existence
from slamcu_core.filter.detections import Instant
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.moving import move_particles, move_sightings
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.relocation import Constellation, Motion, distances, search
from slamcu_core.filter.table import FeatureTable, Kind

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_INTERVAL_S = 2.0  # s between looks
_LEAST = 4  # finds with their doubles; three may stand alike by chance
_STD_M = 0.1  # m, of finds within their arrangement
_SHIFT_M, _TURN = 2.0, 0.6  # m and rad: farther off, health doubts the pose
_CLEARLY = 2  # so many times as many doubles are seen as features of the map where the motion would not have them


class Doubles:
    """Looks for doubles among what is near, and undoes them."""

    def __init__(
        self,
        table: FeatureTable,
        particles: Particles,
        around: Neighbourhood,
        management: MapManagement,
    ) -> None:
        self._table, self._particles = table, particles
        self._around, self._management = around, management
        self._last = -np.inf

    def undo(self, now: Instant, rng: np.random.Generator) -> Array | None:
        """Move the particles by the motion that lays their finds on missed features of the map, if enough fit.

        Those finds become these features. What else was found since the first of them moves along if it is in view, and
        is forgotten if it is not. Return the new place (2,), m; None if there are no doubles.
        """
        if now.t - self._last < _INTERVAL_S:
            return None
        self._last = now.t
        table, rows = self._table, self._around.rows
        kind = table.kind[rows]
        stands = self._management.supports(rows)
        finds = rows[(kind == Kind.NEW) & stands]
        gone = rows[(kind == Kind.MAP) & ~existence.exists(table, rows)]
        gone = gone[table.weight_against[gone] > table.prior[gone] + table.weight_for[gone]]
        if len(finds) < _LEAST or len(gone) < _LEAST:
            return None
        detected = table.open & (table.detected > 0.0)
        places = (self._particles.means.take(table.slot[finds], axis=1) @ self._particles.weights).T
        which, of = self._pairs(finds, places, gone)
        if len(which) < _LEAST:
            return None
        motion = Motion.fitted(places[which], table.xy[gone[of]])
        found = int(np.count_nonzero(detected[finds[which]]))
        if found <= _CLEARLY * self._seen_against(motion, rows[(kind == Kind.MAP) & stands & detected[rows]]):
            return None
        begun = float(table.born[finds[which]].min())
        for find, feature in zip(finds[which].tolist(), gone[of].tolist(), strict=True):
            self._management.recognize(feature, find)
        own = (table.alive & (table.kind == Kind.NEW) & (table.slot >= 0)).nonzero()[0]
        since = own[table.born[own] >= begun]
        for row in since[~detected[since]].tolist():
            self._management.forget(row)
        return self._move(motion, since[detected[since]], rng)

    def _pairs(self, finds: Index, places: Array, gone: Index) -> tuple[Index, Index]:
        """Return which finds (N,) at places (N, 2) are which of the features gone, by the motion most agree on."""
        none = np.zeros(0, dtype=np.intp)
        table = self._table
        there = table.xy[gone]
        seen = Constellation(places, np.full(len(finds), _STD_M), table.feature_class[finds], table.sign[finds])
        fits = seen.fits(table.feature_class[gone], table.sign[gone]) & (distances(places, there) < _SHIFT_M)
        motion, agreed, rival = search(seen, there, fits)
        if motion is None or agreed <= rival or abs(math.remainder(motion.angle, math.tau)) > _TURN:
            return none, none
        off = np.where(fits, distances(motion.apply(places), there), np.inf)
        nearest = off.argmin(axis=1)
        mutual = off.argmin(axis=0)[nearest] == np.arange(len(finds))
        which = (mutual & (off.min(axis=1) < 3.0 * _STD_M)).nonzero()[0]
        return which, nearest[which]

    def _seen_against(self, motion: Motion, seen: Index) -> int:
        """Return how many of the features of the map that are seen in their places would be elsewhere by a motion."""
        off = motion.apply(self._table.xy[seen]) - self._table.xy[seen]
        return int(np.count_nonzero(np.hypot(*off.T) > 3.0 * _STD_M))

    def _move(self, motion: Motion, along: Index, rng: np.random.Generator) -> Array:
        """Move the particles by a motion in the map's frame, with the finds `along` that they place."""
        particles, table = self._particles, self._table
        particles.settle(rng)
        move_particles(particles, table.slot[along], motion.apply, motion.angle)
        move_sightings(table, along, motion.apply, motion.angle)
        return particles.mean_state()[0][:2]
