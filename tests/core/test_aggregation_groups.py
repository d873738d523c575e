"""Connected groups: what steps of at most the reach connect, and nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import connected_groups
from slamcu_core.errors import EvidenceError

points = st.lists(st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)), max_size=40)


def _by_search(xy: list[tuple[float, float]], reach: float) -> list[int]:
    label = [-1] * len(xy)
    for start in range(len(xy)):
        if label[start] >= 0:
            continue
        number, queue = max(label) + 1, [start]
        label[start] = number
        while queue:
            here = queue.pop()
            for other in range(len(xy)):
                if label[other] < 0 and math.dist(xy[here], xy[other]) <= reach:
                    label[other] = number
                    queue.append(other)
    return label


@given(points, st.floats(0.1, 8.0))
def test_the_labels_are_those_of_a_search(xy: list[tuple[float, float]], reach: float) -> None:
    expected = _by_search(xy, reach)
    # a distance within rounding of the reach may fall on either side
    if all(abs(math.dist(a, b) - reach) > 1e-9 for a in xy for b in xy):
        assert connected_groups(np.array(xy).reshape(-1, 2), reach).tolist() == expected


def test_a_chain_is_one_group_and_a_gap_splits_it() -> None:
    chain = [(float(i), 0.0) for i in range(50)]
    assert set(connected_groups(chain, 1.01).tolist()) == {0}
    assert connected_groups([*chain[:20], *chain[22:]], 1.01).tolist() == [0] * 20 + [1] * 28


def test_thousands_of_passes_over_one_sign_are_one_group() -> None:
    xy = np.random.default_rng(1).normal(0.0, 0.7, (20_000, 2))
    assert connected_groups(xy, 5.0).max() == 0


@pytest.mark.parametrize(("xy", "reach"), [([[math.nan, 0.0]], 1.0), ([[0.0, 0.0]], 0.0), ([[0.0, 0.0]], math.nan)])
def test_what_has_no_distance_is_refused(xy: list[list[float]], reach: float) -> None:
    with pytest.raises(EvidenceError):
        connected_groups(xy, reach)


@pytest.mark.parametrize("corner", [(0.0, 0.0), (0.3, -0.4), (-7.7, 12.1)])
def test_two_points_are_one_group_up_to_the_reach_in_every_direction(corner: tuple[float, float]) -> None:
    reach = 2.0
    steps = np.linspace(-3.05, 3.05, 62)  # none of them so far off, to rounding
    for dx in steps:
        for dy in steps:
            pair = np.array([corner, (corner[0] + dx, corner[1] + dy)])
            assert (connected_groups(pair, reach)[1] == 0) == (math.hypot(dx, dy) <= reach), (dx, dy)
