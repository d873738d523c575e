"""Cells of a grid in degrees, by which places are looked up: columns go round the earth."""

from __future__ import annotations

import math
from collections.abc import Iterator

Cell = tuple[int, int]


def cell_of(lon: float, lat: float, size: float) -> Cell:
    """Return the column and row of a place; `size` is the width of a cell, which must divide 180 degrees."""
    return _column(math.floor(lon / size), size), math.floor(lat / size)


def cells_within(lon: float, lat: float, radius_m: float, size: float) -> Iterator[Cell]:
    """Yield the cells within `radius_m` of a place, and some that are farther."""
    north = radius_m / 110_000.0
    east = north / max(math.cos(math.radians(lat)), 0.01)
    first, last = math.floor((lon - east) / size), math.floor((lon + east) / size)
    rows = range(math.floor((lat - north) / size), math.floor((lat + north) / size) + 1)
    for column in range(first, min(last, first + _columns(size) - 1) + 1):
        for row in rows:
            yield _column(column, size), row


def _columns(size: float) -> int:
    return round(360.0 / size)


def _column(column: int, size: float) -> int:
    columns = _columns(size)
    return (column + columns // 2) % columns - columns // 2
