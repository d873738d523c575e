"""What one contributor alone has seen is told by what others miss there, and decided as if they might lie."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import ClassPolicy, FoldedState, PassEvidence, Side, contributions, fold
from slamcu_core.evidence import masses_from_weights
from tests.core.test_aggregation_trust import trusts

HOUR = 3600.0
SURE = 20.0
POLICY = ClassPolicy()
ALIKE = dataclasses.replace(POLICY, trust_against_one=POLICY.trust)  # misses weigh what they decide

passes = st.builds(
    PassEvidence,
    contributor=st.integers(1, 5),
    ended_at=st.floats(0.0, 20 * HOUR),
    weight_for=st.sampled_from([0.0, 0.05, 0.5, 3.0, SURE]),
    weight_against=st.sampled_from([0.0, 0.05, 0.5, 3.0, SURE]),
)


def _story(told: str, policy: ClassPolicy = POLICY, side: Side = Side.NEW) -> FoldedState:
    """Fold sure passes of an hour each, a letter for each contributor: capital where it sees, small where it misses."""
    items = [
        PassEvidence(ord(who.upper()), number * HOUR, SURE * who.isupper(), SURE * who.islower())
        for number, who in enumerate(told)
    ]
    return _fold(items, policy, side)


def _fold(items: list[PassEvidence], policy: ClassPolicy, side: Side = Side.NEW) -> FoldedState:
    prior = 3.0 if side is Side.DELETED else 0.0
    return fold(contributions(items, policy), prior_weight=prior, policy=policy, side=side)


def _belief(state: FoldedState) -> float:
    exists, _, unknown = masses_from_weights(state.weight_for, state.weight_against)
    return float(exists + 0.5 * unknown)


def test_two_misses_of_what_one_car_has_found_leave_hardly_anything_of_it() -> None:
    assert _belief(_story("Abc", ALIKE)) == pytest.approx(0.17, abs=0.01)
    assert _belief(_story("Abc")) < 0.02
    assert _belief(_story("AbAc")) < 0.1, "however often the one sees it"


def test_misses_weigh_by_the_policys_number_and_forget_as_ever() -> None:
    state = _story("Abc")
    miss = -math.log(1.0 - POLICY.trust_against_one)
    assert state.weight_against == pytest.approx((1.0 + POLICY.forgetting) * miss, rel=1e-6)
    assert state.weight_for == _story("Abc", ALIKE).weight_for


@pytest.mark.parametrize(("told", "gone"), [("abc", 0.79), ("abcd", 0.91), ("abcde", 0.955), ("abcdeF", 0.77)])
def test_whoever_denies_a_mapped_sign_is_told_as_sure_as_trust_lets_a_liar_be(told: str, gone: float) -> None:
    state = _story(told, side=Side.DELETED)
    assert masses_from_weights(state.weight_for, state.weight_against)[1] == pytest.approx(gone, abs=0.005)


@pytest.mark.parametrize("told", ["AbcD", "AbcdEfg", "ABc", "AaB"])
def test_from_the_second_who_sees_it_on_a_miss_weighs_as_it_decides(told: str) -> None:
    assert _story(told).steps[-1] == _story(told, ALIKE).steps[-1]


@given(st.lists(passes, max_size=30), st.floats(0.01, 0.999), st.integers(1, 3), st.booleans())
def test_nothing_that_is_decided_depends_on_it(
    items: list[PassEvidence], against_one: float, quorum: int, known: bool
) -> None:
    rules = dataclasses.replace(POLICY, contributors_new=quorum, trusts=trusts(c2=(0.6, known)) if known else None)
    other = dataclasses.replace(rules, trust_against_one=against_one)
    one, two = _fold(items, rules), _fold(items, other)
    decided = [(step.time, step.contributor, step.weight_for, step.standing) for step in one.steps]
    assert decided == [(step.time, step.contributor, step.weight_for, step.standing) for step in two.steps]
    assert (one.contributors_for, one.contributors_against) == (two.contributors_for, two.contributors_against)
    assert (one.standing, one.stood_since, one.folded) == (two.standing, two.stood_since, two.folded)
    if one.standing:
        assert one.weight_against == two.weight_against, "what stands is told as it was decided"
    assert _fold(items, rules, Side.DELETED) == _fold(items, other, Side.DELETED)


@given(st.lists(passes, max_size=30))
def test_it_speaks_only_against_and_never_more_than_its_trust_allows(items: list[PassEvidence]) -> None:
    told, decided = _fold(items, POLICY), _fold(items, ALIKE)
    most = -math.log(1.0 - POLICY.trust_against_one) / (1.0 - POLICY.forgetting)
    for one, other in zip(told.steps, decided.steps, strict=True):
        assert other.weight_against <= one.weight_against * (1.0 + 1e-12) <= most * (1.0 + 1e-9)


def test_a_policy_that_trusts_everybody_more_loses_nothing() -> None:
    robots = ClassPolicy(trust=0.97)
    assert _story("Abc", robots) == _story("Abc", dataclasses.replace(robots, trust_against_one=0.97))


def test_who_has_lost_trust_has_lost_it_here_too() -> None:
    doubted = dataclasses.replace(POLICY, trusts=trusts(c66=(0.2, False)))  # B
    miss = _story("Ab", doubted).weight_against
    assert miss == pytest.approx(-math.log(1.0 - 0.2 * POLICY.trust_against_one), rel=1e-6)


def test_what_says_as_much_for_as_against_is_no_miss() -> None:
    """The one who has found it looks again and cannot tell; then another misses it."""
    items = [
        PassEvidence(1, 0.0, SURE, 0.0),
        PassEvidence(1, HOUR, 0.5, 0.5),
        PassEvidence(2, 2 * HOUR, 0.0, SURE),
    ]
    _, undecided, miss = contributions(items, POLICY)
    assert undecided.weight_for == undecided.weight_against > 0.0
    left = POLICY.forgetting**miss.informativeness
    told = -math.log(1.0 - POLICY.trust_against_one)
    assert _fold(items, POLICY).weight_against == pytest.approx(left * undecided.weight_against + told, rel=1e-6)
