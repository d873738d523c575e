"""What a pass saw beside the place that the map gives a feature: a sign that has moved by a few metres.

From afar, where ranges are vague, or where nothing else explains it, such a sign is taken for the mapped one. At the
end of the pass the car knows where it stood: then the sightings speak against the mapped place, and for a thing of its
own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.beliefs import Beliefs
from slamcu_core.filter.existence import State
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.geometry import inverse
from slamcu_core.hd_map import HDMap

Array = NDArray[np.float64]

_GONE = float(np.log(5.0))  # weight of misses that by themselves say that a thing is gone, with 0.8
_FROM_AFAR = 3.0  # times that weight, at most, of sightings from so far away that they may be of another thing
_ELSEWHERE = 4.61  # chi-square with 2 degrees of freedom at 90 %
_MOVED_M = 1.0  # so far from its place a thing has moved, though no frame missed it there
_SAME_M = 5.0  # what was seen so near to each other may be one thing


@dataclass(frozen=True, slots=True)
class Beside:
    """Tells what the passes of a table's rows saw beside the map; changes nothing."""

    hd_map: HDMap
    table: FeatureTable
    beliefs: Beliefs
    management: MapManagement

    def weight(self, row: int, place: tuple[Array, Array] | None = None) -> float:
        """Return the weight of evidence that what a pass took for the map's feature at a row stands elsewhere.

        `place` is where the row is believed to be, if that has been asked.

        It is 0 unless the place lies outside the 90 % ellipse about the mapped one and either the pass's misses say
        "gone" while what it saw may have been something else, seen from afar, or the place is so far off that the
        thing must have moved. The probability to be so far outside by chance is exp(-d²/2).
        """
        table = self.table
        f, a = float(table.pass_for[row]), float(table.pass_against[row])
        if table.kind[row] != Kind.MAP or not table.detected[row]:
            return 0.0
        squared, distance = self._off(row, place or self.beliefs.place(row))
        missed = a >= _GONE and f <= _FROM_AFAR * a
        if squared <= _ELSEWHERE or not (missed or distance >= _MOVED_M):
            return 0.0
        return squared / 2.0

    def is_in_place(self, row: int, place: tuple[Array, Array]) -> bool:
        """Return whether what was seen at a place may stand where the map has the feature at a row."""
        squared, distance = self._off(row, place)
        return squared <= _ELSEWHERE and distance < _MOVED_M

    def _off(self, row: int, place: tuple[Array, Array]) -> tuple[float, float]:
        """Return how far a place is from where the map has a row: squared, in standard deviations of both; and in m."""
        xy, covariance = place
        variance = self.hd_map.features[int(self.table.source[row])].position_std_m ** 2
        xx, cross, yy = inverse((covariance + np.array([variance, 0.0, variance])).tolist()).tolist()
        x, y = (xy - self.table.xy[row]).tolist()
        return xx * x * x + 2.0 * cross * x * y + yy * y * y, math.hypot(x, y)

    def is_told(self, row: int, place: Array) -> bool:
        """Whether another row tells of what a pass took for the map's feature at a row, and saw at a place (2,)."""
        table = self.table
        others = self.alike(row, place)
        others = others[table.pass_for[others] > table.pass_against[others]]
        finds = others[table.kind[others] == Kind.NEW]
        return len(others) > len(finds) or bool((self.management.classify(finds) == State.NEW.value).any())

    def is_another(self, row: int) -> bool:
        """Whether a watch feature may have been missed only because its sightings were taken for the map's beside it.

        Then its misses say nothing.
        """
        table = self.table
        if table.kind[row] != Kind.WATCH or table.pass_for[row] > table.pass_against[row]:
            return False
        mapped = (table.kind == Kind.MAP) & table.alive & (np.abs(table.xy - table.xy[row]).max(axis=1) < 3.0 * _SAME_M)
        for other in self._overlapping(row, mapped.nonzero()[0]).tolist():
            if self.weight(other) and np.hypot(*(self.beliefs.place(other)[0] - table.xy[row])) <= _SAME_M:
                return True
        return False

    def alike(self, row: int, place: Array) -> NDArray[np.intp]:
        """Return the other rows near a place (2,) that could be the same thing, in view at the same time."""
        near = self.table.alive & (np.hypot(*(self.table.xy - place).T) <= _SAME_M)
        near[row] = False
        return self._overlapping(row, near.nonzero()[0])

    def _overlapping(self, row: int, others: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return which of other rows could be of the same sign and were in view at the same time."""
        table = self.table
        fits = table.feature_class[others] == table.feature_class[row]
        for code in (table.sign, table.value):
            fits &= (code[others] == code[row]) | (code[others] == 0) | (code[row] == 0)
        fits &= (table.pass_last[others] >= table.pass_start[row]) & (table.pass_start[others] <= table.pass_last[row])
        return np.asarray(others[fits & (table.passes[others] > 0)])
