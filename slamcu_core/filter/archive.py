"""What is kept of features left behind: little, and as much at the end of a day as at its beginning.

The feature table holds what is near. A map feature that was left behind leaves three numbers in arrays over the map;
a find of the car's own leaves its row, in a second table that holds the latest few thousand and drops the oldest (its
passes were reported long ago). Both come back as they were when the car returns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.table import FeatureTable
from slamcu_core.geometry import Cell, LocalFrame, cell_of, cells_within

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_CELL_DEG = 0.005  # of the index over finds: a few cells cover any sensor's reach


class MapLedger:
    """The evidence of the drive about map features that are not in the table, by their index in the map.

    Arrays over the whole map, 20 bytes a feature; untouched parts take no memory on most systems.
    """

    def __init__(self, features: int) -> None:
        self.weight_for: Array = np.zeros(features)
        self.weight_against: Array = np.zeros(features)
        self.passes = np.zeros(features, dtype=np.int32)

    def put(self, table: FeatureTable, rows: Index) -> None:
        """Note what rows of the table hold."""
        source = table.source[rows]
        self.weight_for[source] = table.weight_for[rows]
        self.weight_against[source] = table.weight_against[rows]
        self.passes[source] = table.passes[rows]

    def restore(self, table: FeatureTable, rows: Index) -> None:
        """Give rows of the table back what was noted of their features."""
        source = table.source[rows]
        table.weight_for[rows] = self.weight_for[source]
        table.weight_against[rows] = self.weight_against[source]
        table.passes[rows] = self.passes[source]

    def clear(self) -> None:
        """Forget everything."""
        touched = self.passes.nonzero()[0]
        for values in (self.weight_for, self.weight_against, self.passes):
            values[touched] = 0


class FoundArchive:
    """Finds that were left behind, at most `most`, by place; their coordinates are in degrees, not metres."""

    def __init__(self, most: int) -> None:
        self.table = FeatureTable()
        self._most = most
        self._rows: dict[int, Cell] = {}  # row: cell, the oldest first
        self._cells: dict[Cell, list[int]] = {}

    def __len__(self) -> int:
        return len(self._rows)

    def rows(self) -> list[int]:
        """Return the rows in use, the oldest first."""
        return list(self._rows)

    def put(self, table: FeatureTable, row: int, frame: LocalFrame) -> None:
        """Take a row over from the table, whose coordinates are metres in `frame`, and release it there."""
        if len(self._rows) >= self._most:
            self.drop(next(iter(self._rows)))
        kept = self.table.take_over(table, row)
        place = np.array(frame.to_geographic(table.xy[row]))
        self.table.xy[kept] = place
        if table.view_weight[row] > 0.0:
            self.table.view_from[kept] = frame.to_geographic(table.view_from[row] / table.view_weight[row])
        cell = cell_of(float(place[0]), float(place[1]), _CELL_DEG)
        self._rows[kept] = cell
        self._cells.setdefault(cell, []).append(kept)
        table.release(row)

    def near(self, lon: float, lat: float, radius_m: float) -> list[int]:
        """Return the rows in cells within `radius_m` of a place: more than are that near, never fewer."""
        if not self._rows:
            return []
        cells = cells_within(float(lon), float(lat), radius_m, _CELL_DEG)
        return [row for cell in cells for row in self._cells.get(cell, ())]

    def place(self, row: int, frame: LocalFrame) -> Array:
        """Return where a row is, (2,) m in a frame."""
        return frame.to_local(*self.table.xy[row])

    def places(self, rows: list[int], frame: LocalFrame) -> Array:
        """Return where rows are, (K, 2) m in a frame."""
        return frame.to_local(*self.table.xy[rows].T)

    def seen_from(self, row: int, frame: LocalFrame) -> Array:
        """Return where a row was seen from on average, (2,) m in a frame."""
        return frame.to_local(*self.table.view_from[row])

    def give_back(self, row: int, table: FeatureTable, frame: LocalFrame) -> int:
        """Move a row back into the table and return its row there."""
        back = table.take_over(self.table, row)
        table.xy[back] = self.place(row, frame)
        table.view_from[back] = self.seen_from(row, frame) * table.view_weight[back]
        self.drop(row)
        return back

    def clear(self) -> None:
        """Forget everything."""
        for row in self.rows():
            self.drop(row)

    def drop(self, row: int) -> None:
        """Forget a row."""
        cell = self._rows.pop(row)
        self._cells[cell].remove(row)
        if not self._cells[cell]:
            del self._cells[cell]
        self.table.release(row)
