"""Angles: wrapped into one turn, and between the compass and the plane."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from slamcu_core.geometry import compass_to_math, math_to_compass, rotation, wrap_angle, wrap_in_place


@given(st.floats(-50.0, 50.0))
@example(math.pi)
@example(-math.pi)
@example(3.0 * math.pi)
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle: float) -> None:
    many = np.array([angle, angle])
    wrap_in_place(many, np.empty(2))
    for wrapped in (float(wrap_angle(angle)), float(wrap_angle(np.array(angle))), *many.tolist()):
        assert abs(wrapped) <= math.pi + 1e-12
        assert (math.cos(wrapped), math.sin(wrapped)) == pytest.approx((math.cos(angle), math.sin(angle)), abs=1e-12)


@pytest.mark.parametrize(
    ("compass", "mathematical"),
    [(0.0, math.pi / 2), (90.0, 0.0), (180.0, -math.pi / 2), (270.0, -math.pi), (-45.0, 0.75 * math.pi)],
)
def test_the_compass_turns_clockwise_from_north(compass: float, mathematical: float) -> None:
    assert compass_to_math(compass) == pytest.approx(mathematical)
    assert math_to_compass(mathematical) == pytest.approx(compass % 360.0)
    assert math_to_compass(mathematical + 4.0 * math.pi) == pytest.approx(compass % 360.0)


def test_a_rotation_turns_counter_clockwise() -> None:
    np.testing.assert_allclose(rotation(math.pi / 2) @ [2.0, 1.0], [-1.0, 2.0], atol=1e-12)
