"""Contributions: passes summed within a contributor's hour, discounted once, whatever order they come in."""

from __future__ import annotations

import math
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import ClassPolicy, PassEvidence, contributions
from slamcu_core.errors import EvidenceError
from slamcu_core.evidence import Masses, discount

POLICY = ClassPolicy()
HOUR = 3600.0

passes = st.builds(
    PassEvidence,
    contributor=st.integers(1, 5),
    ended_at=st.floats(0.0, 6 * HOUR),
    weight_for=st.floats(0.0, 8.0),
    weight_against=st.floats(0.0, 8.0),
)


@given(st.lists(passes, max_size=40), st.randoms(use_true_random=False))
def test_permutations_give_identical_bits(items: list[PassEvidence], random: Random) -> None:
    shuffled = list(items)
    random.shuffle(shuffled)
    assert contributions(shuffled, POLICY) == contributions(items, POLICY)


@given(st.lists(passes, max_size=40))
def test_they_come_in_order_of_time_then_contributor_and_lose_no_pass(items: list[PassEvidence]) -> None:
    folded = contributions(iter(items), POLICY)
    keys = [(item.time, item.contributor) for item in folded]
    assert keys == sorted(keys)
    assert sum(item.passes for item in folded) == len(items)
    assert len({(item.contributor, item.epoch) for item in folded}) == len(folded)
    for item in folded:
        assert item.epoch * HOUR <= item.time < (item.epoch + 1) * HOUR


@given(st.lists(passes, min_size=1, max_size=12))
def test_a_contribution_is_the_sum_discounted_once(items: list[PassEvidence]) -> None:
    for item in contributions(items, POLICY):
        mine = [p for p in items if p.contributor == item.contributor and p.ended_at // HOUR == item.epoch]
        total = Masses.from_weights(sum(p.weight_for for p in mine), sum(p.weight_against for p in mine))
        expected = discount(total, POLICY.trust)
        assert (item.weight_for, item.weight_against) == pytest.approx(expected.weights, rel=1e-9, abs=1e-12)
        assert item.informativeness == pytest.approx((1.0 - expected.unknown) / POLICY.trust, abs=1e-12)
        assert item.passes == len(mine)
        assert item.time == max(p.ended_at for p in mine)


@given(st.floats(0.0, 1e7), st.floats(0.0, 1e7))
def test_no_contribution_is_worth_more_than_its_trust_allows(weight_for: float, weight_against: float) -> None:
    (only,) = contributions([PassEvidence(1, 0.0, weight_for, weight_against)], POLICY)
    most = -math.log(1.0 - POLICY.trust) + 1e-12
    assert 0.0 <= only.weight_for <= most
    assert 0.0 <= only.weight_against <= most
    assert 0.0 <= only.informativeness <= 1.0


def test_a_blocked_pass_says_nothing() -> None:
    (only,) = contributions([PassEvidence(1, 0.0, 0.0, 0.0)], POLICY)
    assert (only.weight_for, only.weight_against, only.informativeness) == (0.0, 0.0, 0.0)


def test_a_flood_of_passes_in_one_hour_is_one_contribution() -> None:
    flood = [PassEvidence(7, 10.0 * i, 0.0, 4.0) for i in range(300)]
    (only,) = contributions(flood, POLICY)
    assert only.passes == 300
    assert only.weight_against == pytest.approx(-math.log(0.3), abs=1e-12)


def test_an_hour_ends_where_the_next_begins() -> None:
    just_before, at = contributions(
        [PassEvidence(1, HOUR, 1.0, 0.0), PassEvidence(1, math.nextafter(HOUR, 0.0), 1.0, 0.0)], POLICY
    )
    assert (just_before.epoch, at.epoch) == (0, 1)
    (before_1970,) = contributions([PassEvidence(1, -1.0, 1.0, 0.0)], POLICY)
    assert before_1970.epoch == -1


def test_a_distrusted_contributor_can_neither_say_nor_erase_much() -> None:
    sure = [PassEvidence(1, 0.0, 0.0, 9.0), PassEvidence(2, 0.0, 0.0, 9.0), PassEvidence(3, 0.0, 0.0, 9.0)]
    full, little, none = contributions(sure, POLICY, {1: 0.7, 2: 0.1, 3: 0.0}.__getitem__)
    assert full == contributions(sure[:1], POLICY)[0]
    assert little.weight_against < -math.log(0.9)
    assert little.informativeness == pytest.approx(0.1 / 0.7, abs=1e-3)
    assert (none.weight_against, none.informativeness) == (0.0, 0.0)
    (more,) = contributions(sure[:1], POLICY, lambda _: 0.95)
    assert more.weight_against > full.weight_against
    assert more.informativeness == 1.0


@pytest.mark.parametrize("alpha", [-0.1, 1.0, math.nan])
def test_a_trust_out_of_range_is_refused_with_its_contributor(alpha: float) -> None:
    with pytest.raises(EvidenceError, match="trust of contributor 42"):
        contributions([PassEvidence(42, 0.0, 1.0, 0.0)], POLICY, lambda _: alpha)


@pytest.mark.parametrize(
    "bad",
    [
        PassEvidence(1, 0.0, -1e-9, 0.0),
        PassEvidence(1, 0.0, 0.0, math.nan),
        PassEvidence(1, 0.0, math.inf, 0.0),
        PassEvidence(1, math.nan, 1.0, 0.0),
        PassEvidence(1, math.inf, 1.0, 0.0),
    ],
)
def test_evidence_that_is_none_is_refused(bad: PassEvidence) -> None:
    with pytest.raises(EvidenceError, match="finite"):
        contributions([bad], POLICY)


def test_nothing_contributes_nothing() -> None:
    assert contributions([], POLICY) == []
