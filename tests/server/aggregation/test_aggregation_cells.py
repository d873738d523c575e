"""The cells that batches lock: whoever could touch the same evidence shares one of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.geometry import LocalFrame
from slamcu_server.aggregation.cells import Cell, cell_at, cells_within, lock_keys, map_key
from slamcu_server.aggregation.locks import BeyondLockedCells, require_cells

longitudes = st.floats(-180.0, 180.0)
latitudes = st.floats(-90.0, 90.0)


@given(longitudes, latitudes, st.floats(0.1, 200.0), st.floats(0.0, 2 * math.pi))
def test_a_place_within_reach_lies_in_the_cells_within_reach(
    lon: float, lat: float, reach: float, angle: float
) -> None:
    frame = LocalFrame(lon, min(max(lat, -89.9), 89.9))
    there = 0.999 * reach * np.array([math.cos(angle), math.sin(angle)])
    other_lon, other_lat = (float(one) for one in frame.to_geographic(there))
    other_lon = (other_lon + 180.0) % 360.0 - 180.0
    cells = cells_within(7, lon, min(max(lat, -89.9), 89.9), reach)
    assert cell_at(7, other_lon, other_lat) in cells


@given(longitudes, latitudes)
def test_a_place_lies_in_its_cell_and_few_cells_are_near(lon: float, lat: float) -> None:
    cell = cell_at(1, lon, lat)
    west, south, east, north = cell.bounds
    assert south - 1e-9 <= lat <= north + 1e-9
    assert west - 1e-9 <= lon <= east + 1e-9 or abs(lon) > 180.0 - 1e-9
    near = cells_within(1, lon, lat, 5.0)
    assert cell in near
    assert len(near) <= 4 or abs(lat) > 89.0


@given(st.lists(st.tuples(st.integers(1, 2**20), longitudes, latitudes), max_size=20))
def test_locks_are_taken_in_one_order_and_fit_the_key(places: list[tuple[int, float, float]]) -> None:
    cells = {cell for place in places for cell in cells_within(*place, 10.0)}
    keys = lock_keys(cells)
    assert keys == sorted(set(keys))
    assert len(keys) == len(cells)
    assert all(0 < key < 2**63 for key in keys)
    for cell in cells:
        assert map_key(cell.map_id) < cell.key < map_key(cell.map_id + 1)


def test_what_is_needed_must_be_held() -> None:
    one, other = Cell(1, 5, 5), Cell(1, 5, 6)
    require_cells(frozenset({one}), frozenset({one, other}))
    require_cells(frozenset({one}), None)
    with pytest.raises(BeyondLockedCells) as beyond:
        require_cells(frozenset({one, other}), frozenset({one}))
    assert beyond.value.cells == {other}
