"""Columns fold to what lists fold to: the law is one, whatever the passes are held in."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamcu_core.aggregation import (
    ClassPolicy,
    PassColumns,
    PassEvidence,
    Side,
    contributions,
    fold,
    fold_columns,
)
from slamcu_core.errors import EvidenceError

_WEIGHTS = st.one_of(st.just(0.0), st.floats(0.0, 6.0))
_PASSES = st.builds(
    PassEvidence,
    contributor=st.integers(1, 5),
    ended_at=st.integers(0, 40).map(lambda n: 1_000_000_000.25 + 900.0 * n),
    weight_for=_WEIGHTS,
    weight_against=_WEIGHTS,
    doubtful=st.sampled_from([False, False, True]),
)
_POLICY = ClassPolicy(window=6, contributors_deleted=2, contributors_in_doubt=2)


def columns(features: list[list[PassEvidence]]) -> PassColumns:
    flat = [(number, item) for number, passes in enumerate(features) for item in passes]
    return PassColumns(
        np.array([number for number, _ in flat], np.intp),
        np.array([item.contributor for _, item in flat], np.int64),
        np.array([item.ended_at for _, item in flat], float),
        np.array([item.weight_for for _, item in flat], float),
        np.array([item.weight_against for _, item in flat], float),
        np.array([item.doubtful for _, item in flat], bool),
    )


@given(
    features=st.lists(st.lists(_PASSES, max_size=25), max_size=4),
    side=st.sampled_from(Side),
    prior=st.sampled_from([0.0, 3.0]),
    trusts=st.sampled_from([None, {1: 0.7, 2: 0.0, 3: 0.4, 4: 0.9, 5: 0.2}]),
    seed=st.integers(0, 9),
)
@settings(max_examples=120)
def test_columns_fold_to_what_lists_fold_to(
    features: list[list[PassEvidence]], side: Side, prior: float, trusts: dict[int, float] | None, seed: int
) -> None:
    table = columns(features)
    order = np.random.default_rng(seed).permutation(len(table.feature))
    shuffled = table.take(order)
    trust = None if trusts is None else np.array([trusts[who] for who in shuffled.contributor.tolist()])
    found = fold_columns(shuffled, np.full(len(features), prior), _POLICY, deleted=side is Side.DELETED, trust=trust)
    for number, passes in enumerate(features):
        made = contributions(passes, _POLICY, None if trusts is None else trusts.__getitem__)
        state = fold(made, prior_weight=prior, policy=_POLICY, side=side)
        assert found.weight_for[number] == pytest.approx(state.weight_for, abs=1e-9)
        assert found.weight_against[number] == pytest.approx(state.weight_against, abs=1e-9)
        assert found.standing[number] == state.standing
        assert found.contributors_for[number] == state.contributors_for
        assert found.contributors_against[number] == state.contributors_against
        assert found.folded[number] == state.folded
        for time, wanted in (
            (found.last_informative[number], state.last_informative),
            (found.oldest[number], state.oldest),
            (found.stood_since[number], state.stood_since),
            (found.turned_after[number], state.turned_after),
            (found.turned_at[number], state.turned_at),
        ):
            assert time == wanted if wanted is not None else math.isnan(time)


def test_nothing_folds_to_the_prior() -> None:
    found = fold_columns(columns([[], []]), [1.5, 0.0], ClassPolicy(), deleted=True)
    assert found.weight_for.tolist() == [1.5, 0.0]
    assert found.weight_against.tolist() == [0.0, 0.0]
    assert not found.standing.any()
    assert found.folded.tolist() == [0, 0]
    assert np.isnan(found.last_informative).all()


@pytest.mark.parametrize("weight", [-1.0, math.nan, math.inf])
def test_impossible_weights_are_refused(weight: float) -> None:
    passes = columns([[PassEvidence(1, 0.0, 1.0, weight)]])
    with pytest.raises(EvidenceError, match="against"):
        fold_columns(passes, [0.0], ClassPolicy(), deleted=True)
