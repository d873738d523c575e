"""Pairing: a sign that moved or says something else is one change, whatever order the halves are looked at in."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import ClassPolicy, Half, Pairing, Policy, pair

POLICY = Policy()
DAY = 86400.0


def half(
    key: str,
    x: float,
    y: float = 0.0,
    *,
    sign: str | None = "SPEED_LIMIT",
    value: str | None = "80",
    feature_class: str = "traffic_sign",
    begun: tuple[float | None, float | None] = (None, 0.0),
    std_m: float = 0.3,
    heading_deg: float | None = None,
    standing: bool = True,
    contributors: int = 1,
    weak: bool = False,
) -> tuple[Half, np.ndarray]:
    covariance = std_m**2 * np.eye(2)
    made = Half(key, (key,), feature_class, sign, value, covariance, begun, heading_deg, standing, contributors, weak)
    return made, np.array([x, y])


def paired(features: list[Any], candidates: list[Any], policy: Policy = POLICY) -> list[Pairing]:
    places = {one.key: place for one, place in (*features, *candidates)}
    return pair(
        [one for one, _ in features],
        [one for one, _ in candidates],
        lambda feature, candidate: places[candidate.key] - places[feature.key],
        policy,
    )


@pytest.mark.parametrize(
    ("candidate", "expected"),
    [
        (half("c", 3.0), False),  # three metres on
        (half("c", 25.0), False),
        (half("c", 31.0), None),
        (half("c", 0.4, value="60"), True),
        (half("c", 0.4, sign="STOP_SIGN", value=None), True),
        (half("c", 3.0, value="60"), None),  # elsewhere and another: two changes
        (half("c", 3.0, sign="STOP_SIGN"), None),
        (half("c", 3.0, sign=None, value=None), None),  # what it is must be known to know it again elsewhere
        (half("c", 3.0, feature_class="pole", sign=None, value=None), None),
        (half("c", 0.4), False),
        # a vague place is within the gate of anything, and the same only within the match radius
        (half("c", POLICY.default.match_radius_m, value="60", std_m=5.0), True),
        (half("c", POLICY.default.match_radius_m + 0.01, value="60", std_m=5.0), None),
    ],
)
def test_what_two_halves_are_together(candidate: Any, expected: bool | None) -> None:
    found = paired([half("f", 0.0)], [candidate])
    assert found == ([] if expected is None else [Pairing("f", "c", modified=expected)])


@pytest.mark.parametrize(
    ("gone", "came", "one"),
    [
        ((0.0, 2 * DAY), (None, 5 * DAY), True),
        ((0.0, 2 * DAY), (33 * DAY, 33 * DAY), False),  # the other came a month after
        ((40 * DAY, 41 * DAY), (0.0, 1.0), False),  # both stood there for a month
        ((None, 300 * DAY), (0.0, 1.0), True),  # nobody knows since when the old one is gone
        ((None, 0.0), (33 * DAY, 33 * DAY), False),
    ],
)
def test_a_sign_moves_at_one_time(gone: Any, came: Any, one: bool) -> None:
    assert bool(paired([half("f", 0.0, begun=gone)], [half("c", 3.0, begun=came)])) is one


@pytest.mark.parametrize(
    ("heading_deg", "x", "y", "one"),
    [
        (90.0, 15.0, 2.0, True),  # along the road, which goes east
        (270.0, -15.0, 2.0, True),
        (90.0, 2.0, 15.0, False),  # on its other side
        (None, 2.0, 15.0, True),  # nobody knows where the road goes
        (0.0, 2.0, 15.0, True),
        (45.0, 12.0, 12.0, True),
        (45.0, 12.0, -12.0, False),
    ],
)
def test_a_sign_on_the_other_side_of_the_road_is_another(heading_deg: Any, x: float, y: float, one: bool) -> None:
    assert bool(paired([half("f", 0.0, heading_deg=heading_deg)], [half("c", x, y)])) is one


def test_the_nearest_goes_first_and_nothing_is_used_twice() -> None:
    features = [half("f1", 0.0), half("f2", 20.0)]
    candidates = [half("c1", 3.0), half("c2", 24.0), half("c3", 10.0)]
    assert paired(features, candidates) == [Pairing("f1", "c1", False), Pairing("f2", "c2", False)]


def test_another_class_has_another_radius() -> None:
    policy = Policy(classes={"pole": ClassPolicy(pair_radius_m=6.0)})
    poles = {"feature_class": "pole", "sign": None, "value": None}
    assert paired([half("f", 0.0, **poles)], [half("c", 5.0, **poles)], policy)
    assert not paired([half("f", 0.0, **poles)], [half("c", 7.0, **poles)], policy)


def test_what_stands_is_paired_before_what_one_car_has_seen_however_vaguely() -> None:
    gone, sure = half("f", 0.0), half("sure", 3.0, std_m=0.2)
    vague = half("vague", 4.0, std_m=3.0, standing=False)
    assert paired([gone], [vague, sure]) == [Pairing("f", "sure", modified=False)]
    # beside nothing that stands it is better than none
    assert paired([gone], [vague]) == [Pairing("f", "vague", modified=False)]
    nearly = half("nearly", 2.9, std_m=3.0, standing=False)
    assert paired([nearly, gone], [sure]) == [Pairing("f", "sure", modified=False)]


def test_what_several_have_seen_is_paired_before_what_one_has_though_neither_stands() -> None:
    one = half("one", 0.5, value="60", standing=False)
    several = half("several", 1.0, value="70", standing=False, contributors=2)
    assert paired([half("f", 0.0)], [one, several]) == [Pairing("f", "several", modified=True)]
    assert paired([half("f", 0.0)], [one]) == [Pairing("f", "one", modified=True)]


def test_what_is_weakly_denied_pairs_last_and_only_with_what_is_like_it_and_near() -> None:
    denied = half("denied", 0.0, weak=True, standing=False)
    assert paired([denied], [half("c", 4.9)]) == [Pairing("denied", "c", modified=False)]
    assert not paired([denied], [half("c", 5.1)])
    assert not paired([denied], [half("c", 0.4, value="60")])
    assert paired([denied, half("gone", 9.0, standing=False)], [half("c", 1.0)]) == [
        Pairing("gone", "c", modified=False)
    ]


@given(st.integers(0, 10_000))
def test_the_order_of_looking_changes_nothing(seed: int) -> None:
    rng = random.Random(seed)
    # on a grid, so that many distances are equal
    features = [half(f"f{i}", 3.0 * rng.randrange(6), value=rng.choice(["80", "60"])) for i in range(5)]
    candidates = [half(f"c{i}", 3.0 * rng.randrange(6), value=rng.choice(["80", "60"])) for i in range(5)]
    expected = paired(features, candidates)
    for _ in range(3):
        assert paired(rng.sample(features, 5), rng.sample(candidates, 5)) == expected
    assert len({one.feature for one in expected}) == len({one.candidate for one in expected}) == len(expected)
