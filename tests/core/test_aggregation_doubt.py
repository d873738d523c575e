"""Who says that he is not to be trusted is heard only where many do in one place, and agree; and never for more."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamcu_core.aggregation import (
    EPOCH_S,
    ClassPolicy,
    FoldedState,
    PassEvidence,
    Side,
    Trusts,
    contributions,
    fold,
)

FULL = 3.0  # weight of a sure pass (λ = 0.95)
NOBODY_KNOWN = ClassPolicy(trusts=Trusts(1))
ENOUGH = ClassPolicy().contributors_in_doubt


def folded(told: str, policy: ClassPolicy = NOBODY_KNOWN, side: Side = Side.DELETED) -> FoldedState:
    """Fold passes an hour apart, each by another car: `s` sees and `m` misses, in capitals in doubt, `.` is blocked."""
    passes = [
        PassEvidence(
            number, number * EPOCH_S, FULL * (letter in "sS"), FULL * (letter in "mM"), doubtful=letter.isupper()
        )
        for number, letter in enumerate(told)
    ]
    return fold_all(passes, policy, side)


def fold_all(passes: list[PassEvidence], policy: ClassPolicy, side: Side = Side.DELETED) -> FoldedState:
    prior = FULL if side is Side.DELETED else 0.0
    return fold(contributions(passes, policy), prior_weight=prior, policy=policy, side=side)


def amount(state: FoldedState) -> tuple[float, float, bool]:
    return state.weight_for, state.weight_against, state.standing


def test_many_who_doubt_in_one_place_and_miss_the_same_sign_are_believed_that_it_is_gone() -> None:
    assert folded("M" * ENOUGH).standing
    assert folded("ssss" + "M" * (ENOUGH + 1)).standing  # as the law takes one more after a long history
    assert folded("M.MM..MM").standing  # who saw nothing contradicts nobody
    assert amount(folded("M" * (ENOUGH - 1))) == amount(folded(""))


def test_many_who_doubt_and_see_the_same_new_sign_are_believed() -> None:
    assert folded("S" * ENOUGH, side=Side.NEW).standing
    assert amount(folded("S" * (ENOUGH - 1), side=Side.NEW)) == (0.0, 0.0, False)


@pytest.mark.parametrize("told", ["MMMsMMM", "MMMSMMM", "sMsMsMsMsMsMsMsMs", "SMSMSMSMSMSMSMSM", "mmMMM", "MMMmm"])
def test_those_who_are_lost_say_nothing_where_others_see_the_sign_between_them(told: str) -> None:
    trusted = "".join("." if letter.isupper() else letter for letter in told)
    assert amount(folded(told)) == amount(folded(trusted))
    assert not folded(told).standing


def test_one_car_in_doubt_is_one_however_often_it_comes() -> None:
    again = [PassEvidence(number % (ENOUGH - 1), number * EPOCH_S, 0.0, FULL, doubtful=True) for number in range(60)]
    assert amount(fold_all(again, NOBODY_KNOWN)) == amount(folded(""))


def test_whoever_doubts_speaks_without_a_record() -> None:
    known = Trusts(1, np.arange(9), np.ones(9), np.full(9, -math.inf))
    policy = ClassPolicy(trusts=known, strangers_more=2)
    assert folded("mmmm", policy).standing
    assert folded("MMMM", policy).weight_against == folded("mmmm", policy).weight_against, "they are heard"
    assert not folded("MMMM", policy).standing, "but it takes as many as it takes strangers"
    assert folded("MMMMM", policy).standing


def test_in_an_hour_in_which_a_car_spoke_without_doubt_its_doubt_says_nothing() -> None:
    sure = [PassEvidence(number, number * EPOCH_S, 0.0, 1.0) for number in range(4)]
    unsure = [replace(item, ended_at=item.ended_at + 60.0, weight_against=9.0, doubtful=True) for item in sure]
    policy = ClassPolicy(contributors_in_doubt=2)
    assert amount(fold_all(sure + unsure, policy)) == amount(fold_all(sure, policy))


def test_a_policy_may_hear_nobody_in_doubt() -> None:
    deaf = replace(NOBODY_KNOWN, contributors_in_doubt=0)
    assert amount(folded("M" * 40, deaf)) == amount(folded("", deaf))
    assert ClassPolicy(contributors_in_doubt=0).to_document()["contributors_in_doubt"] == 0


_PASSES = st.builds(
    PassEvidence,
    contributor=st.integers(1, 6),
    ended_at=st.integers(0, 60).map(lambda n: 1800.0 * n),
    weight_for=st.sampled_from([0.0, 0.0, 2.0, 4.0]),
    weight_against=st.sampled_from([0.0, 0.5, 3.0]),
    doubtful=st.booleans(),
)


@given(passes=st.lists(_PASSES, max_size=60), side=st.sampled_from(Side), seed=st.integers(0, 9))
@settings(max_examples=150)
def test_what_is_heard_depends_on_nothing_older_than_the_window_nor_on_order(
    passes: list[PassEvidence], side: Side, seed: int
) -> None:
    policy = ClassPolicy(window=8, contributors_deleted=2, contributors_in_doubt=3)
    whole = fold_all(passes, policy, side)
    kept = passes
    if whole.folded == policy.window and whole.oldest is not None:
        begin = math.floor(whole.oldest / EPOCH_S)
        kept = [item for item in passes if math.floor(item.ended_at / EPOCH_S) >= begin]
    shuffled = [kept[number] for number in np.random.default_rng(seed).permutation(len(kept)).tolist()]
    assert fold_all(shuffled, policy, side) == whole


@given(passes=st.lists(_PASSES, max_size=40), side=st.sampled_from(Side))
def test_fewer_than_enough_in_doubt_change_no_weight(passes: list[PassEvidence], side: Side) -> None:
    policy = ClassPolicy()
    few = [item for item in passes if not item.doubtful or item.contributor <= 3]
    trusted = [item for item in few if not item.doubtful]
    assert amount(fold_all(few, policy, side)) == pytest.approx(amount(fold_all(trusted, policy, side)))
