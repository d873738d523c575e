"""The local frame: there and back, anywhere on earth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from slamcu_core.geometry import LocalFrame, to_local_each

shifts = st.floats(-3000.0, 3000.0)


@given(st.floats(-180.0, 180.0), st.floats(-90.0, 90.0), shifts, shifts)
@example(180.0, 89.9999, 0.0, 20.0)  # over the pole
@example(0.0, 90.0, 3.0, 11.0)  # from it
@example(12.0, -90.0, 0.0, 0.0)
@example(-180.0, 0.0, -1e-9, 1.0)  # what is a little west of -180 is not east of it
@example(-180.0, 60.0, -1e-3, 0.0)
@example(179.99999, -16.5, 5.0, 0.0)
def test_every_place_is_lifted_to_one_on_earth_that_projects_back(lon: float, lat: float, x: float, y: float) -> None:
    frame = LocalFrame(lon, lat)
    there = frame.to_geographic((x, y))
    assert -180.0 <= float(there[0]) < 180.0
    assert -90.0 <= float(there[1]) <= 90.0
    assert frame.to_local(*there) == pytest.approx([x, y], abs=1e-7)
    many = frame.to_geographic(np.array([[[x, y], [0.0, 0.0]]]))
    assert many[0].shape == many[1].shape == (1, 2)
    assert (many[0][0, 0], many[1][0, 0]) == pytest.approx((float(there[0]), float(there[1])), abs=1e-12)


def test_a_place_keeps_its_longitude_to_the_last_digit_but_one() -> None:
    lon, lat = LocalFrame(2.1000001, 48.9).to_geographic((0.0, 10.0))
    assert float(lon) == 2.1000001
    assert math.isclose(float(lat), 48.9 + 10.0 / 111_212.0, abs_tol=1e-8)


def test_places_are_projected_each_to_its_own_frame() -> None:
    frames = [LocalFrame(2.1, 48.9), LocalFrame(-179.999, -16.5), LocalFrame(10.0, 89.99)]
    which, lon, lat = [2, 0, 1, 0], [11.0, 2.11, 179.999, 2.09], [89.995, 48.91, -16.49, 48.89]
    expected = [frames[number].to_local(*place) for number, *place in zip(which, lon, lat, strict=True)]
    np.testing.assert_allclose(to_local_each(frames, which, lon, lat), expected, atol=1e-8)
