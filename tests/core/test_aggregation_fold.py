"""The fold: a pure function of the set of contributions, with a quorum, hysteresis and a bounded memory."""

from __future__ import annotations

import dataclasses
import itertools
import math
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import (
    ClassPolicy,
    Contribution,
    FoldedState,
    PassEvidence,
    Side,
    contributions,
    decayed,
    fades_at,
    fades_each,
    fold,
)
from slamcu_core.errors import EvidenceError
from slamcu_core.evidence import Masses, masses_from_weights, support

POLICY = ClassPolicy()
HOUR, DAY = 3600.0, 86400.0
PRIOR = float(support(0.95))
SURE = 40.0  # a weight that leaves nothing unknown before the discount

passes = st.builds(
    PassEvidence,
    contributor=st.integers(1, 6),
    ended_at=st.floats(0.0, 40 * HOUR),
    weight_for=st.sampled_from([0.0, 0.01, 0.5, 3.0, SURE]),
    weight_against=st.sampled_from([0.0, 0.01, 0.5, 3.0, SURE]),
)
sides = st.sampled_from(Side)


def _deletion(items: list[PassEvidence], policy: ClassPolicy = POLICY) -> FoldedState:
    return fold(contributions(items, policy), prior_weight=PRIOR, policy=policy, side=Side.DELETED)


def _creation(items: list[PassEvidence], policy: ClassPolicy = POLICY) -> FoldedState:
    return fold(contributions(items, policy), prior_weight=0.0, policy=policy, side=Side.NEW)


def _story(told: str, *, contributors: int = 10**6, first: int = 0) -> list[PassEvidence]:
    """Return sure passes an hour apart by contributors in turn: s seen, m missed, b blocked."""
    weights = {"s": (SURE, 0.0), "m": (0.0, SURE), "b": (0.0, 0.0)}
    return [PassEvidence(1 + i % contributors, (first + i) * HOUR, *weights[c]) for i, c in enumerate(told)]


@given(st.lists(passes, max_size=40), sides, st.randoms(use_true_random=False))
def test_neither_order_nor_batching_matters(items: list[PassEvidence], side: Side, random: Random) -> None:
    whole = fold(contributions(items, POLICY), prior_weight=PRIOR, policy=POLICY, side=side)
    shuffled = list(items)
    random.shuffle(shuffled)
    parts = contributions(shuffled, POLICY)
    random.shuffle(parts)
    assert fold(iter(parts), prior_weight=PRIOR, policy=POLICY, side=side) == whole


@given(st.lists(passes, min_size=1, max_size=30), sides, st.data())
def test_the_state_at_an_earlier_time_is_the_fold_of_what_was_there(
    items: list[PassEvidence], side: Side, data: st.DataObject
) -> None:
    # the steps explain: each equals a fold from nothing of the contributions up to it
    parts = contributions(items, POLICY)
    whole = fold(parts, prior_weight=PRIOR, policy=POLICY, side=side)
    if whole.steps:
        step = data.draw(st.sampled_from(whole.steps))
        until = [p for p in parts if (p.time, p.contributor) <= (step.time, step.contributor)]
        assert fold(until, prior_weight=PRIOR, policy=POLICY, side=side).steps[-1] == step
        assert whole.steps[-1].standing is whole.standing
        assert (whole.weight_for, whole.weight_against) == (whole.steps[-1].weight_for, whole.steps[-1].weight_against)


@given(st.lists(passes, max_size=20), sides, st.integers(100, 105), st.floats(0.0, 40 * HOUR))
def test_a_pass_that_saw_nothing_changes_nothing(
    items: list[PassEvidence], side: Side, contributor: int, at: float
) -> None:
    def state(some: list[PassEvidence]) -> FoldedState:
        return fold(contributions(some, POLICY), prior_weight=PRIOR, policy=POLICY, side=side)

    assert state([*items, PassEvidence(contributor, at, 0.0, 0.0)]) == state(items)
    assert state([*items, PassEvidence(contributor, at, 0.01, 0.0)]) == state(items)


def test_the_weights_follow_the_law_step_by_step() -> None:
    items = [PassEvidence(1, 0.0, 2.0, 0.0), PassEvidence(2, HOUR, 0.0, 1.0), PassEvidence(3, 2 * HOUR, SURE, 0.5)]
    F, A = PRIOR, 0.0
    for part, step in zip(contributions(items, POLICY), _deletion(items).steps, strict=True):
        kept = 0.8**part.informativeness
        F, A = kept * F + part.weight_for, kept * A + part.weight_against
        assert (step.weight_for, step.weight_against) == pytest.approx((F, A), abs=1e-12)


def test_without_contributions_the_prior_is_all_there_is() -> None:
    assert _deletion([]) == FoldedState(PRIOR, 0.0, 0, 0, None, standing=False, stood_since=None, steps=())
    certain = fold([], prior_weight=50.0, policy=POLICY, side=Side.NEW)
    assert not certain.standing  # a prior is no contributor


@given(st.lists(passes, min_size=1, max_size=40), st.data())
def test_retraction_is_the_fold_without(items: list[PassEvidence], data: st.DataObject) -> None:
    liar = data.draw(st.sampled_from(sorted({item.contributor for item in items})))
    rest = [item for item in items if item.contributor != liar]
    parts = [part for part in contributions(items, POLICY) if part.contributor != liar]
    assert fold(parts, prior_weight=PRIOR, policy=POLICY, side=Side.DELETED) == _deletion(rest)


def test_the_retraction_of_liars_heals_a_change_at_once() -> None:
    lie, truth = _story("mmmm", contributors=4), _story("ss", first=10)
    honest = [dataclasses.replace(item, contributor=item.contributor + 50) for item in truth]
    assert _deletion(lie).standing
    assert not _deletion(honest).standing


@given(st.lists(passes, max_size=20), st.integers(0, 30))
def test_only_the_newest_window_folds(items: list[PassEvidence], older: int) -> None:
    policy = dataclasses.replace(POLICY, window=5)
    newest = _story("smsms", first=100)
    ancient = [dataclasses.replace(item, ended_at=item.ended_at - older * DAY) for item in items]
    assert _deletion([*ancient, *newest], policy) == _deletion(newest, policy)
    assert len(_deletion([*ancient, *newest], policy).steps) == 5


def test_blocked_passes_do_not_push_evidence_out_of_the_window() -> None:
    policy = dataclasses.replace(POLICY, window=5)
    assert _deletion(_story("mmmm" + "b" * 20), policy) == _deletion(_story("mmmm"), policy)


def test_dropping_what_the_window_drops_changes_nothing_that_matters() -> None:
    long = contributions(_story("s" * 60 + "m" * 4 + "s" * 60), POLICY)
    whole = fold(long, prior_weight=PRIOR, policy=dataclasses.replace(POLICY, window=1000), side=Side.DELETED)
    kept = fold(long[-64:], prior_weight=PRIOR, policy=POLICY, side=Side.DELETED)
    assert (kept.weight_for, kept.weight_against) == pytest.approx((whole.weight_for, whole.weight_against), abs=1e-5)
    assert kept.standing is whole.standing


def test_four_unanimous_full_misses_delete_a_fresh_map_feature_and_three_do_not() -> None:
    three, four = _deletion(_story("mmm")), _deletion(_story("mmmm"))
    assert not three.standing
    assert three.contributors_against == 3
    assert Masses.from_weights(three.weight_for, three.weight_against).not_exists == pytest.approx(0.794, abs=1e-3)
    assert four.standing
    assert four.stood_since == 3 * HOUR


def test_two_cars_make_a_new_feature_and_one_car_never_does() -> None:
    assert not _creation(_story("s")).standing
    assert _creation(_story("ss")).standing
    assert not _creation(_story("s" * 200, contributors=1)).standing
    assert not _deletion(_story("m" * 200, contributors=1)).standing
    assert not _deletion(_story("m" * 200, contributors=2)).standing
    assert _deletion(_story("mmmm", contributors=3)).standing


def test_a_miss_that_is_forgotten_does_not_help_one_car_to_a_quorum() -> None:
    honest = _story("smsssssmssssssssssss")  # 20 cars, of whom two once missed
    flood = [PassEvidence(99, (20 + i) * HOUR, 0.0, SURE) for i in range(40)]
    state = _deletion([*honest, *flood])
    assert Masses.from_weights(state.weight_for, state.weight_against).not_exists > POLICY.enter
    assert state.contributors_against == 1
    assert not state.standing


def test_contributors_are_counted_on_their_own_side() -> None:
    state = _deletion(_story("smsms"))
    assert (state.contributors_for, state.contributors_against) == (3, 2)


def test_a_change_is_withdrawn_when_the_evidence_turns() -> None:
    # a sign that was covered for four passes and is uncovered
    covered = _story("ssssss" + "mmmmmm")
    assert _deletion(covered).standing
    assert _deletion(covered).stood_since == 10 * HOUR
    back = _deletion([*covered, *_story("sss", first=12)])
    assert not back.standing
    assert back.stood_since is None
    again = _deletion([*covered, *_story("sss" + "mmmmmm", first=12)])
    assert again.standing
    assert again.stood_since is not None
    assert again.stood_since > 12 * HOUR


def test_a_candidate_that_nobody_else_sees_dies() -> None:
    lie = _story("ss", contributors=2)
    honest = [PassEvidence(50 + i, (10 + i) * HOUR, 0.0, SURE) for i in range(5)]
    assert _creation(lie).standing
    assert not _creation([*lie, *honest]).standing


@pytest.mark.parametrize("side", Side)
@pytest.mark.parametrize("start", ["", "mmmm", "ssss"])
@pytest.mark.parametrize(("beat", "most"), [("sm", 2), ("ms", 2), ("smb", 2), ("ssmm", 6)])
def test_alternation_does_not_flicker(side: Side, start: str, beat: str, most: int) -> None:
    story = start + "".join(itertools.islice(itertools.cycle(beat), 60))
    prior = PRIOR if side is Side.DELETED else 0.0
    state = fold(contributions(_story(story), POLICY), prior_weight=prior, policy=POLICY, side=side)
    standing = [step.standing for step in state.steps]
    switches = sum(one is not other for one, other in itertools.pairwise(standing))
    assert switches <= most
    assert len(set(standing[-30:])) == 1


def test_reading_halves_the_weights_each_half_life() -> None:
    state = _creation(_story("sss"))
    last = state.last_informative
    assert last == 2 * HOUR
    half = decayed(state, last + POLICY.half_life_days * DAY, POLICY)
    assert half == pytest.approx((state.weight_for / 2, state.weight_against / 2), rel=1e-12)
    assert decayed(state, last, POLICY) == (state.weight_for, state.weight_against)
    assert decayed(state, last - DAY, POLICY) == (state.weight_for, state.weight_against)
    assert decayed(_deletion([]), 1e12, POLICY) == (PRIOR, 0.0)


def test_time_alone_decays_both_sides_to_ignorance() -> None:
    state = _deletion(_story("mmmm"))
    long_after = Masses.from_weights(*decayed(state, 50 * 365 * DAY, POLICY))
    assert long_after.unknown == pytest.approx(1.0, abs=1e-9)


def test_two_contributions_of_one_epoch_are_refused() -> None:
    one = Contribution(1, 0, 10.0, 0.5, 0.0, 0.5, 1)
    with pytest.raises(EvidenceError, match="two contributions in one epoch"):
        fold([one, dataclasses.replace(one, time=20.0)], prior_weight=0.0, policy=POLICY, side=Side.NEW)


@pytest.mark.parametrize("prior", [-1.0, math.nan, math.inf])
def test_a_prior_out_of_range_is_refused(prior: float) -> None:
    with pytest.raises(EvidenceError, match="prior"):
        fold([], prior_weight=prior, policy=POLICY, side=Side.DELETED)


def test_one_car_cannot_make_fall_what_others_made_stand() -> None:
    stood = _story("mmmmm")
    alone = [PassEvidence(99, (10 + i) * HOUR, SURE, 0.0) for i in range(8)]
    assert _deletion(stood + alone).standing
    two = [PassEvidence(99 + i % 2, (10 + i) * HOUR, SURE, 0.0) for i in range(8)]
    assert not _deletion(stood + two).standing


@pytest.mark.parametrize("mass", [0.3, 0.5, 0.7])
@pytest.mark.parametrize(
    ("told", "side"), [("mmmmm", Side.DELETED), ("mmmmms", Side.DELETED), ("ss", Side.NEW), ("ssssm", Side.NEW)]
)
def test_what_nobody_looks_at_any_more_fades_at_a_moment_that_is_known(told: str, side: Side, mass: float) -> None:
    state = _deletion(_story(told)) if side is Side.DELETED else _creation(_story(told))
    assert state.standing
    moment = fades_at(state, POLICY, side, mass)
    assert moment is not None

    def reads(as_of: float) -> float:
        read = Masses.from_weights(*decayed(state, as_of, POLICY))
        return float(read.exists if side is Side.NEW else read.not_exists)

    assert reads(moment - 60.0) >= mass > reads(moment + 60.0)


def test_what_stands_only_for_want_of_witnesses_fades_when_it_would_undisputed() -> None:
    state = _deletion(_story("mmmmm") + [PassEvidence(99, (10 + i) * HOUR, SURE, 0.0) for i in range(4)])
    assert state.standing
    assert Masses.from_weights(*decayed(state, 0.0, POLICY)).not_exists < POLICY.leave
    for mass in (0.3, POLICY.leave):
        moment = fades_at(state, POLICY, Side.DELETED, mass)
        assert moment is not None
        _, against = decayed(state, moment, POLICY)
        assert Masses.from_weights(0.0, against).not_exists == pytest.approx(mass, abs=1e-6)
    # what would be below it even undisputed has faded by now
    assert fades_at(state, POLICY, Side.DELETED, 0.99) == state.last_informative


def test_moments_of_fading_are_exact_and_do_not_depend_on_what_else_is_asked() -> None:
    rng = np.random.default_rng(7)
    own = rng.exponential(4.0, 500) * 10.0 ** rng.uniform(-3.0, 1.0, 500)
    other = own * rng.uniform(0.0, 1.2, 500)
    masses = rng.choice([0.1, 0.4, 0.5, 0.65, 0.8, 0.99], 500)
    last = rng.uniform(0.0, 10.0 * DAY, 500)
    told = fades_each(own, other, last, masses, policy=POLICY, side=Side.NEW)
    kept = 0.5 ** ((told - last) / DAY / POLICY.half_life_days)
    exists, _, _ = masses_from_weights(own, other)
    reads, _, _ = masses_from_weights(kept * own, kept * other)
    speaks = exists >= masses
    assert 100 < speaks.sum() < 400
    np.testing.assert_allclose(reads[speaks], masses[speaks], rtol=1e-9)
    for one in range(0, 500, 7):
        alone = slice(one, one + 1)
        assert (
            fades_each(own[alone], other[alone], last[alone], masses[alone], policy=POLICY, side=Side.NEW) == told[one]
        )


def test_what_nobody_spoke_for_never_fades() -> None:
    assert fades_at(_deletion(_story("sss")), POLICY, Side.DELETED, 0.5) is None
    assert fades_at(_deletion([]), POLICY, Side.DELETED, 0.5) is None


def test_the_fold_tells_when_the_evidence_turned() -> None:
    def turn(told: str) -> tuple[float | None, float | None]:
        state = _deletion(_story(told))
        return state.turned_after, state.turned_at

    assert turn("ssmmmmm") == (1 * HOUR, 2 * HOUR)
    assert turn("ssmmmmmsmmm") == (1 * HOUR, 2 * HOUR)  # one who errs does not bring it back
    assert turn("mmmmsss") == (None, None)
    assert turn("mmm") == (None, 0.0)
    assert turn("ss" + "m" * 70) == (None, 8 * HOUR)  # the window does not reach back to it


@pytest.mark.parametrize(("told", "side"), [("ss", Side.NEW), ("mmmm", Side.DELETED)])
def test_a_change_stands_from_the_very_mass_on(told: str, side: Side) -> None:
    def folded(policy: ClassPolicy) -> FoldedState:
        prior = PRIOR if side is Side.DELETED else 0.0
        return fold(contributions(_story(told), policy), prior_weight=prior, policy=policy, side=side)

    state = folded(POLICY)
    exists, not_exists, _ = masses_from_weights(state.weight_for, state.weight_against)
    mass = float(exists if side is Side.NEW else not_exists)
    assert folded(dataclasses.replace(POLICY, enter=mass)).steps[-1].standing
    assert not folded(dataclasses.replace(POLICY, enter=math.nextafter(mass, 1.0))).steps[-1].standing
