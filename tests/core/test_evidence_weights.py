"""Weights of evidence: legal masses, addition as Dempster's rule, and no overflow (design, section 2)."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.errors import EvidenceError
from slamcu_core.evidence import (
    LAMBDA_MAX,
    Masses,
    clamp_confidence,
    conflict,
    conjunctive,
    dempster,
    discount,
    masses_from_weights,
    support,
    weights_from_masses,
)

weights = st.floats(0.0, 30.0)
wide_weights = st.floats(0.0, 1e7)
pairs = st.tuples(weights, weights)
confidences = st.floats(0.0, 1.0)
outside = st.one_of(st.floats(max_value=-1e-300), st.floats(min_value=math.nextafter(1.0, 2.0)), st.just(math.nan))


def _close(one: Masses, other: Masses, tolerance: float = 1e-12) -> bool:
    return all(
        abs(a - b) <= tolerance
        for a, b in (
            (one.exists, other.exists),
            (one.not_exists, other.not_exists),
            (one.unknown, other.unknown),
        )
    )


@given(wide_weights, wide_weights)
def test_masses_lie_in_the_unit_interval_and_sum_to_one(f: float, a: float) -> None:
    e, n, u = masses_from_weights(f, a)
    assert 0.0 <= e <= 1.0
    assert 0.0 <= n <= 1.0
    assert 0.0 <= u <= 1.0
    assert e + n + u == pytest.approx(1.0, abs=1e-15 * 4)


@given(pairs, pairs)
def test_adding_weights_is_dempsters_rule(one: tuple[float, float], other: tuple[float, float]) -> None:
    combined = dempster(Masses.from_weights(*one), Masses.from_weights(*other))
    assert _close(combined, Masses.from_weights(one[0] + other[0], one[1] + other[1]))


@given(st.lists(st.tuples(confidences, st.booleans()), min_size=1, max_size=30), st.randoms(use_true_random=False))
def test_the_order_of_reports_does_not_matter(reports: list[tuple[float, bool]], random: Random) -> None:
    shuffled = list(reports)
    random.shuffle(shuffled)

    def combine(sequence: list[tuple[float, bool]]) -> Masses:
        masses = Masses.vacuous()
        for confidence, seen in sequence:
            masses = dempster(masses, Masses.detected(confidence) if seen else Masses.missed(confidence))
        return masses

    assert _close(combine(reports), combine(shuffled))


@given(pairs)
def test_a_vacuous_report_changes_nothing(given_weights: tuple[float, float]) -> None:
    masses = Masses.from_weights(*given_weights)
    assert _close(dempster(masses, Masses.vacuous()), masses, 1e-15)
    assert support(0.0) == 0.0
    assert Masses.vacuous().weights == (0.0, 0.0)


@given(pairs)
def test_weights_survive_the_way_through_masses(given_weights: tuple[float, float]) -> None:
    f, a = given_weights
    back_f, back_a = Masses.from_weights(f, a).weights
    # the masses of a weak side beside a strong one keep their digits, so the weights do too
    assert back_f == pytest.approx(f, rel=1e-9, abs=1e-12)
    assert back_a == pytest.approx(a, rel=1e-9, abs=1e-12)


def test_a_million_reports_neither_overflow_nor_lose_the_normalisation() -> None:
    rng = np.random.default_rng(7)
    seen = rng.random(1_000_000) < 0.6
    reports = support(rng.uniform(0.0, 1.0, seen.size))
    f, a = np.cumsum(np.where(seen, reports, 0.0)), np.cumsum(np.where(seen, 0.0, reports))
    e, n, u = masses_from_weights(f, a)
    for mass in (e, n, u):
        assert np.all((mass >= 0.0) & (mass <= 1.0))
    np.testing.assert_allclose(e + n + u, 1.0, rtol=0.0, atol=1e-15 * 4)
    assert f[-1] > 500_000.0
    assert e[-1] == 1.0


@pytest.mark.parametrize(
    ("f", "a", "exists"), [(1e7, 0.0, 1.0), (0.0, 1e7, 0.0), (1e7, 1e7, 0.5), (1e7, 1e7 - 1.0, 1 / (1 + math.exp(-1)))]
)
def test_weights_of_ten_million_are_legal(f: float, a: float, exists: float) -> None:
    masses = Masses.from_weights(f, a)
    assert masses.exists == pytest.approx(exists, abs=1e-12)
    assert masses.unknown > 0.0
    assert all(math.isfinite(weight) for weight in masses.weights)


def test_sources_that_are_certain_of_opposites_combine_to_a_draw() -> None:
    combined = dempster(Masses.from_weights(1e7, 0.0), Masses.from_weights(0.0, 1e7))
    assert combined.exists == combined.not_exists == 0.5
    assert combined.unknown > 0.0


def test_the_paper_rule_survives_two_thousand_confirmations() -> None:
    masses = Masses.vacuous()
    for _ in range(2_000):
        masses = dempster(masses, Masses.detected(0.9))
    assert masses.exists == 1.0
    assert masses.unknown > 0.0


@given(pairs, pairs)
def test_conflict_is_the_mass_of_the_empty_set(one: tuple[float, float], other: tuple[float, float]) -> None:
    for_only, against_only = Masses.from_weights(one[0], 0.0), Masses.from_weights(0.0, other[1])
    empty, *_ = conjunctive(for_only, against_only)
    assert conflict(one[0], other[1]) == pytest.approx(empty, abs=1e-12)
    assert 0.0 <= conflict(*one) <= 1.0


def test_conflict_tells_dispute_from_ignorance() -> None:
    disputed, ignorant = Masses.from_weights(5.0, 5.0), Masses.vacuous()
    assert disputed.conflict > 0.98
    assert ignorant.conflict == 0.0


def test_a_confidence_of_exactly_one_is_clamped() -> None:
    assert clamp_confidence(1.0) == LAMBDA_MAX == 0.99
    assert Masses.detected(1.0) == Masses.detected(0.99)
    assert Masses.missed(1.0) == Masses.missed(0.99)
    assert support(1.0) == pytest.approx(-math.log(0.01))
    assert clamp_confidence([0.0, 0.5, 0.995]).tolist() == [0.0, 0.5, 0.99]


@given(outside)
def test_a_confidence_outside_the_unit_interval_is_refused(confidence: float) -> None:
    for use in (clamp_confidence, support, Masses.detected, Masses.missed):
        with pytest.raises(EvidenceError, match=r"must lie in \[0, 1\]"):
            use(confidence)


@given(confidences)
def test_simple_support_adds_its_weight_to_one_side(confidence: float) -> None:
    lam = min(confidence, LAMBDA_MAX)
    seen, missed = Masses.detected(confidence), Masses.missed(confidence)
    assert (seen.exists, seen.not_exists) == (lam, 0.0)
    assert (missed.exists, missed.not_exists) == (0.0, lam)
    assert seen.weights == pytest.approx((float(support(confidence)), 0.0), abs=1e-12)
    assert missed.weights == pytest.approx((0.0, float(support(confidence))), abs=1e-12)


@pytest.mark.parametrize(
    "masses", [(-0.1, 0.6, 0.5), (0.6, -0.1, 0.5), (0.5, 0.5, 0.0), (0.5, 0.5, 0.5), (math.nan, 0.5, 0.5)]
)
def test_masses_that_are_none_are_refused(masses: tuple[float, float, float]) -> None:
    with pytest.raises(EvidenceError, match="mass"):
        Masses(*masses)
    with pytest.raises(EvidenceError, match="mass"):
        weights_from_masses(*masses)


@given(pairs, st.floats(0.01, 1.0))
def test_discounting_takes_the_same_share_from_both_sides(given_weights: tuple[float, float], trust: float) -> None:
    masses = Masses.from_weights(*given_weights)
    less = discount(masses, trust)
    assert less.exists == trust * masses.exists
    assert less.not_exists == trust * masses.not_exists
    assert less.exists + less.not_exists + less.unknown == pytest.approx(1.0, abs=1e-12)
    if trust < 1.0:
        # one source is worth at most -ln(1 - α), however sure it is
        assert sum(less.weights) <= 2.0 * -math.log1p(-trust)
        assert max(less.weights) <= -math.log1p(-trust) + 1e-12


@pytest.mark.parametrize("trust", [0.0, -0.5, 1.0001, math.nan])
def test_trust_outside_its_range_is_refused(trust: float) -> None:
    with pytest.raises(EvidenceError, match="trust"):
        discount(Masses.vacuous(), trust)
