"""Finds in the place of a mapped thing of their kind: the thing itself, which a car had believed gone.

What was missed for long is taken for gone, and then its detections found a find of its own. At the end of the pass the
car knows where it stood: in the mapped place. This mirrors `beside`, which takes sightings from the mapped place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcu_core.filter.beliefs import Beliefs
from slamcu_core.filter.beside import Beside
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.table import FeatureTable, Kind


@dataclass(frozen=True, slots=True)
class Reunion:
    """Joins finds with the mapped features in whose place they stand."""

    table: FeatureTable
    beliefs: Beliefs
    beside: Beside
    management: MapManagement

    def join(self, rows: list[int]) -> list[int]:
        """Join what belongs together among rows whose passes end, and return what is left to end."""
        table = self.table
        ending = set(rows)
        for row in rows:
            if row not in ending:
                continue
            if table.kind[row] == Kind.NEW:
                if there := self._in_place(row):
                    self._take_in(there[0], row, ending)
            elif table.kind[row] == Kind.MAP and table.pass_against[row] > table.pass_for[row]:
                finds = self.beside.alike(row, table.xy[row])
                for find in finds[table.kind[finds] == Kind.NEW].tolist():
                    if row in self._in_place(find):
                        self._take_in(row, find, ending)
        return sorted(ending)

    def _in_place(self, find: int) -> list[int]:
        """Return the missed features of the map that a find stands in the place of, the nearest first."""
        table = self.table
        if not table.weight_for[find] > table.weight_against[find]:
            return []
        place = self.beliefs.place(find)
        others = self.beside.alike(find, place[0])
        others = others[(table.kind[others] == Kind.MAP) & (table.pass_against[others] > table.pass_for[others])]
        there = [other for other in others.tolist() if self.beside.is_in_place(other, place)]
        return sorted(there, key=lambda other: float(np.hypot(*(table.xy[other] - place[0]))))

    def _take_in(self, mapped: int, find: int, ending: set[int]) -> None:
        ending.discard(find)
        if not self.table.open[mapped]:
            ending.add(mapped)
        self.management.unite(mapped, find)
