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

import numpy as np
from numpy.typing import ArrayLike, NDArray

_ROW_DEG = 0.01
_ROWS = round(180 / _ROW_DEG)
_COLUMNS_AT_EQUATOR = round(360 / _ROW_DEG)
_METRES_PER_DEG = 110_500.0  # the shortest degree of latitude on WGS84: errs to the side of more cells
_COLUMN_BITS = 16
_CELL_BITS = 31
_COLUMN_MASK, _ROW_MASK = (1 << _COLUMN_BITS) - 1, (1 << _CELL_BITS - _COLUMN_BITS) - 1
_REGION_DEG, _REGION_BITS = 0.02, 15


@dataclass(frozen=True, slots=True, order=True)
class Cell:
    """One cell of one map."""

    map_id: int
    row: int
    column: int

    @classmethod
    def of_key(cls, key: int) -> Cell:
        """Return the cell that a key belongs to."""
        return cls(key >> _CELL_BITS, (key >> _COLUMN_BITS & _ROW_MASK) - 1, key & _COLUMN_MASK)

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
    _, keys = keys_within([map_id], [lon], [lat], reach_m)
    return frozenset(map(Cell.of_key, keys.tolist()))


def keys_within(
    map_id: ArrayLike, lon: ArrayLike, lat: ArrayLike, reach_m: float
) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the same for N places at once: M cells by their keys, and the number of the place that each is for."""
    maps, east, north = np.asarray(map_id, np.int64), np.asarray(lon, float), np.asarray(lat, float)
    reach = reach_m / _METRES_PER_DEG
    south_row, north_row = _rows(north - reach), _rows(north + reach)
    # the cosine of the latitude in reach that is nearest to a pole
    width = reach / np.cos(np.radians(np.minimum(89.999, np.abs(north) + reach)))
    numbers, keys = [np.zeros(0, np.intp)], [np.zeros(0, np.int64)]
    for up in range(int((north_row - south_row).max(initial=-1)) + 1):
        chosen = np.flatnonzero(south_row + up <= north_row)
        rows = south_row[chosen] + up
        distinct, which = np.unique(rows, return_inverse=True)
        columns = np.array([_columns(row) for row in distinct.tolist()], np.int64)[which]
        first = np.floor((east[chosen] - width[chosen] + 180.0) / 360.0 * columns).astype(np.int64)
        last = np.floor((east[chosen] + width[chosen] + 180.0) / 360.0 * columns).astype(np.int64)
        last = np.where(2 * width[chosen] >= 360.0 - 360.0 / columns, first + columns - 1, last)
        for along in range(int((last - first).max(initial=-1)) + 1):
            within = first + along <= last
            column = (first[within] + along) % columns[within]
            numbers.append(chosen[within])
            keys.append(maps[chosen[within]] << _CELL_BITS | (rows[within] + 1) << _COLUMN_BITS | column)
    return np.concatenate(numbers), np.concatenate(keys)


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


def regions_of(cells: Iterable[Cell]) -> set[int]:
    """Return the regions in which the middles of cells lie."""
    return {
        region_at((west + east) / 2, (south + north) / 2) for west, south, east, north in (one.bounds for one in cells)
    }


def lock_keys(cells: Iterable[Cell]) -> list[int]:
    """Return the locks' keys in the one order in which everybody takes them."""
    return sorted({cell.key for cell in cells})


def _row(lat: float) -> int:
    return min(max(floor((lat + 90.0) / _ROW_DEG), 0), _ROWS - 1)


def _rows(lat: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.clip(np.floor((lat + 90.0) / _ROW_DEG).astype(np.int64), 0, _ROWS - 1)


@lru_cache(maxsize=4096)
def _columns(row: int) -> int:
    south = -90.0 + row * _ROW_DEG
    poleward = max(abs(south), abs(south + _ROW_DEG))
    return max(1, floor(_COLUMNS_AT_EQUATOR * cos(radians(min(poleward, 90.0)))))


def _column(lon: float, columns: int) -> int:
    return floor((lon + 180.0) / 360.0 * columns) % columns


__all__ = ["Cell", "cell_at", "cells_within", "keys_within", "lock_keys", "map_key", "region_at", "regions_of"]
