"""The motion model of eq. 12: arcs are exact, steering and yaw rate agree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.errors import SlamcuError
from slamcu_core.models import advance, arc, yaw_rate_from_steering


@given(st.floats(-3, 3), st.floats(-30, 30), st.floats(-2, 2))
def test_an_arc_equals_many_small_straight_steps(heading: float, distance: float, turn: float) -> None:
    start = np.array([1.0, -2.0, heading])
    steps = 4000
    angles = heading + turn * (np.arange(steps) + 0.5) / steps
    expected = start[:2] + distance / steps * np.array([np.cos(angles).sum(), np.sin(angles).sum()])
    moved = advance(start, distance, turn)
    np.testing.assert_allclose(moved[:2], expected, atol=1e-5)
    assert moved[2] == pytest.approx(heading + turn)


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-30, 30), st.floats(-2, 2)), min_size=1, max_size=5))
def test_many_arcs_at_once_are_each_as_one_alone(arcs: list[tuple[float, float, float]]) -> None:
    heading, distance, turn = np.array(arcs).T
    directions, chords = arc(heading, distance, turn)
    for index in range(len(arcs)):
        moved = advance(np.array([0.0, 0.0, heading[index]]), float(distance[index]), float(turn[index]))
        np.testing.assert_allclose(chords[:, index], moved[:2], atol=1e-9)
        middle = heading[index] + 0.5 * turn[index]
        np.testing.assert_allclose(directions[:, index], [np.cos(middle), np.sin(middle)], atol=1e-9)


@given(st.floats(-3, 3), st.floats(-30, 30), st.floats(-2, 2))
def test_driving_back_along_the_arc_returns(heading: float, distance: float, turn: float) -> None:
    start = np.array([1.0, -2.0, heading])
    back = advance(advance(start, distance, turn), -distance, -turn)
    np.testing.assert_allclose(back, start, atol=1e-9)


def test_steering_is_the_bicycle_model() -> None:
    assert yaw_rate_from_steering(20.0, 0.01, 2.7) == pytest.approx(20.0 * np.tan(0.01) / 2.7)
    assert yaw_rate_from_steering(20.0, 0.0, 2.7) == 0.0


def test_steering_without_a_wheelbase_is_refused_by_name() -> None:
    with pytest.raises(SlamcuError, match="wheelbase_m"):
        yaw_rate_from_steering(20.0, 0.01, None)
