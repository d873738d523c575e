"""What was believed before the car lost its way: a filter that has found it again goes on from there.

Its beliefs since then are of a wrong pose, and those of before are worth keeping. When that was, Page's rule tells by
which health adds up what speaks against the pose: hardly later than when the sum was 0 last (Page 1954 takes that for
the moment of change), and earlier if the pose that was held then, moved on by dead reckoning, is not where the car is
now known to be. Nobody is sure that the way was not lost before, so what is believed again is believed less.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.detections import Instant
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.relocation import Motion
from slamcu_core.filter.table import Columns, FeatureTable, Kind
from slamcu_core.geometry import LocalFrame

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_INTERVAL_S = 2.0  # s between moments that are remembered ...
_MOMENTS = 150  # ... and how many are
_RECKONED_S = 120.0  # s; after a longer way dead reckoning agrees by chance ...
_AGREES_M = 0.5  # ... within so much
_BEFORE_S = 30.0  # s before the sum rose, if no pose agrees: what shows a wrong pose takes a while to show
_LEFT = 2.0  # most by which what is believed again outweighs what is against it: a mass of 0.86 with nothing against
_LEFT_OF_FINDS = 0.65  # of finds, which may be of an earlier wrong pose: a few misses refute them


class _OfMap(NamedTuple):
    """Features of the map (F,) near the car: their indices, priors, and the drive's weights for and against them."""

    source: Index
    prior: Array
    weight_for: Array
    weight_against: Array


class _Moment(NamedTuple):
    """What was believed at a time, and where the car was thought to be."""

    t: float
    frame: LocalFrame
    reckoned: Array  # (3,)
    pose: Array  # (3,)
    of_map: _OfMap
    finds: Columns | None  # None: something spoke against the pose


class Retrospect:
    """Remembers what was believed over the last minutes of one drive, and brings it back."""

    def __init__(
        self, table: FeatureTable, particles: Particles, around: Neighbourhood, management: MapManagement
    ) -> None:
        self._table, self._particles = table, particles
        self._around, self._management = around, management
        self._moments: deque[_Moment] = deque(maxlen=_MOMENTS)
        self._in_order_at = -np.inf  # s, when nothing spoke against the pose

    def forget(self) -> None:
        """Forget all moments: what was believed then, or how the car moved since, is not to be relied on."""
        self._moments.clear()

    def note(self, now: Instant, *, in_order: bool) -> None:
        """Remember a moment every other second, of which `in_order` says whether nothing speaks against the pose."""
        if in_order:
            self._in_order_at = now.t
        if self._moments and now.t - self._moments[-1].t < _INTERVAL_S:
            return
        table = self._table
        rows = (table.alive & (table.kind != Kind.NEW)).nonzero()[0]
        self._moments.append(
            _Moment(
                now.t,
                self._around.frame,
                now.reckoned,
                now.pose,
                _OfMap(table.source[rows], table.prior[rows], table.weight_for[rows], table.weight_against[rows]),
                self._finds() if in_order else None,
            )
        )

    def _finds(self) -> Columns:
        """Return the car's finds, each of them where it is believed to be whatever the pose."""
        table = self._table
        rows = (table.alive & (table.kind == Kind.NEW)).nonzero()[0]
        finds = table.copied(rows)
        live = (finds["slot"] >= 0).nonzero()[0]
        if len(live):
            means, covariances = self._particles.collapse(finds["slot"][live])
            finds["xy"][live], finds["covariance"][live] = means.T, covariances.T
        return finds

    def bring_back(self, now: Instant) -> bool:
        """Believe what was believed before the car lost its way, of which the particles know now where it leads.

        Open passes are dropped. Return False, with nothing changed, if nothing is remembered of before.
        """
        since = self._before_the_loss(now)
        if since is None:
            return False
        moment = self._moments[since]
        weights: dict[int, tuple[float, float]] = {}
        for later in reversed([*islice(self._moments, since, None)]):  # what was believed at first stays
            source, prior, weight_for, against = later.of_map
            less = _less(weight_for, against, prior=prior)
            weights.update(zip(source.tolist(), zip(*(each.tolist() for each in less), strict=True), strict=True))
        self._believe_of_the_map(weights)
        self._believe_of_finds(moment)
        self._management.drop_passes()
        self._around.let_go()
        while self._moments[-1] is not moment:
            self._moments.pop()
        self._in_order_at = now.t
        return True

    def _before_the_loss(self, now: Instant) -> int | None:
        """Return which moment is the last one from a right pose, None if that is not remembered."""
        pose, _ = self._particles.mean_state()
        way = Motion.between(now.reckoned, pose)
        before: int | None = None
        for index, moment in self._in_order():
            off = way.apply(moment.reckoned[:2]) - moment.pose[:2]
            if now.t - moment.t < _RECKONED_S and np.hypot(*off) < _AGREES_M:
                return index
            if before is None and moment.t <= self._in_order_at - _BEFORE_S:
                before = index
        return before

    def _in_order(self) -> Iterator[tuple[int, _Moment]]:
        """Yield the moments of which all is known until the sum rose, the latest first."""
        for index in range(len(self._moments) - 1, -1, -1):
            moment = self._moments[index]
            if moment.frame is self._around.frame and moment.finds is not None and moment.t <= self._in_order_at:
                yield index, moment

    def _believe_of_the_map(self, weights: dict[int, tuple[float, float]]) -> None:
        table, around = self._table, self._around
        for source, believed in weights.items():
            row = around.row_of(source)
            if row is None:
                around.ledger.weight_for[source], around.ledger.weight_against[source] = believed
            else:
                table.weight_for[row], table.weight_against[row] = believed

    def _believe_of_finds(self, moment: _Moment) -> None:
        """Put the finds of a moment in the place of those, and of all that were made since."""
        assert moment.finds is not None  # noqa: S101 - such moments are not chosen
        table, found = self._table, self._around.found
        known = moment.finds["number"]

        def is_of_before(of: FeatureTable, row: int) -> bool:
            return bool(of.born[row] <= moment.t) and of.number[row] not in known

        for row in (table.alive & (table.kind == Kind.NEW)).nonzero()[0].tolist():
            if not is_of_before(table, row):
                self._management.forget(row)
        for row in found.rows():
            if not is_of_before(found.table, row):
                found.drop(row)
        rows = table.paste(moment.finds)
        table.weight_for[rows], table.weight_against[rows] = _less(
            table.weight_for[rows], table.weight_against[rows], most=_LEFT_OF_FINDS
        )


def _less(weight_for: Array, against: Array, *, prior: Array | float = 0.0, most: float = _LEFT) -> tuple[Array, Array]:
    """Return weights (F,) of the drive with what prevails made less: what is for them outweighs by `most` at most."""
    less = np.minimum(weight_for, against + most)
    return less, np.minimum(against, prior + less + _LEFT)
