"""The map cells that a batch locks, so that two workers never fold the same evidence at once.

A cell is about 1.1 km high and at least as wide, everywhere on earth: rows of 0.01 degrees of latitude, each cut into
as many columns as fit at its poleward edge. Whoever changes anything at a place holds every cell within reach of it;
two changes that could touch each other therefore always share a cell.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from math import cos, floor, radians

_ROW_DEG = 0.01
_ROWS = round(180 / _ROW_DEG)
_COLUMNS_AT_EQUATOR = round(360 / _ROW_DEG)
_METRES_PER_DEG = 110_500.0  # the shortest degree of latitude on WGS84: errs to the side of more cells
_COLUMN_BITS = 16
_CELL_BITS = 31
_REGION_DEG, _REGION_BITS = 0.02, 15


@dataclass(frozen=True, slots=True, order=True)
class Cell:
    """One cell of one map."""

    map_id: int
    row: int
    column: int

    @property
    def key(self) -> int:
        """The key of this cell's advisory lock."""
        return (self.map_id << _CELL_BITS) | ((self.row + 1) << _COLUMN_BITS) | self.column

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north edge in degrees."""
        columns = _columns(self.row)
        width = 360.0 / columns
        return (
            -180.0 + self.column * width,
            -90.0 + self.row * _ROW_DEG,
            -180.0 + (self.column + 1) * width,
            -90.0 + (self.row + 1) * _ROW_DEG,
        )


def map_key(map_id: int) -> int:
    """Return the key of the lock on a whole map: held shared beside cells, exclusively instead of too many of them."""
    return map_id << _CELL_BITS


def cell_at(map_id: int, lon: float, lat: float) -> Cell:
    """Return the cell in which a place (degrees) lies."""
    row = _row(lat)
    return Cell(map_id, row, _column(lon, _columns(row)))


def cells_within(map_id: int, lon: float, lat: float, reach_m: float) -> frozenset[Cell]:
    """Return every cell that a circle of `reach_m` metres around a place (degrees) may touch."""
    north = reach_m / _METRES_PER_DEG
    south_row, north_row = _row(lat - north), _row(lat + north)
    if south_row == north_row:  # most circles lie within one cell
        columns = _columns(south_row)
        at, east = (lon + 180.0) / 360.0 * columns, north / _narrowest(lat, north) / 360.0 * columns
        if floor(at - east) == floor(at + east) and columns > 4:
            return frozenset((Cell(map_id, south_row, floor(at) % columns),))
    cells: set[Cell] = set()
    for row in range(south_row, north_row + 1):
        columns = _columns(row)
        east = north / _narrowest(lat, north)
        if 2 * east >= 360.0 - 360.0 / columns:
            cells.update(Cell(map_id, row, column) for column in range(columns))
            continue
        first = floor((lon - east + 180.0) / 360.0 * columns)
        last = floor((lon + east + 180.0) / 360.0 * columns)
        cells.update(Cell(map_id, row, column % columns) for column in range(first, last + 1))
    return frozenset(cells)


def region_at(lon: float, lat: float) -> int:
    """Return the region of a place (degrees): a number whose neighbours are near each other on the ground, mostly.

    Regions are 0.02 degrees wide and high, numbered along a Z-order curve (Morton 1966). Worth nothing but to put work
    in an order: who works along it touches few cells at a time.
    """
    east, north = floor((lon + 180.0) / _REGION_DEG), floor((lat + 90.0) / _REGION_DEG)
    number = 0
    for bit in range(_REGION_BITS):
        number |= (east >> bit & 1) << 2 * bit | (north >> bit & 1) << 2 * bit + 1
    return number


def lock_keys(cells: Iterable[Cell]) -> list[int]:
    """Return the locks' keys in the one order in which everybody takes them."""
    return sorted({cell.key for cell in cells})


def _row(lat: float) -> int:
    return min(max(floor((lat + 90.0) / _ROW_DEG), 0), _ROWS - 1)


def _narrowest(lat: float, north: float) -> float:
    """Return the cosine of the latitude within `north` degrees of a place that is nearest to a pole."""
    return cos(radians(min(89.999, abs(lat) + north)))


@lru_cache(maxsize=4096)
def _columns(row: int) -> int:
    south = -90.0 + row * _ROW_DEG
    poleward = max(abs(south), abs(south + _ROW_DEG))
    return max(1, floor(_COLUMNS_AT_EQUATOR * cos(radians(min(poleward, 90.0)))))


def _column(lon: float, columns: int) -> int:
    return floor((lon + 180.0) / 360.0 * columns) % columns


__all__ = ["Cell", "cell_at", "cells_within", "lock_keys", "map_key", "region_at"]
