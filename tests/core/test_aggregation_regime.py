"""The regime of the policy's start values: false deletions against passes to a decision.

Run the three functions with other arguments to choose other values; the table in `slamcu_core/aggregation/policy.py`
holds what they gave.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from slamcu_core.aggregation import (
    ClassPolicy,
    Histories,
    PassEvidence,
    Side,
    contributions,
    discounted,
    fold,
    fold_columns,
    fold_histories,
)
from slamcu_core.evidence import support
from tests.core.test_aggregation_columns import columns

POLICY = ClassPolicy()
PRIOR = float(support(0.95))
SURE = 40.0

Flags = NDArray[np.bool_]


def _stands(missed: Flags, policy: ClassPolicy) -> Flags:
    """Say after each full pass, by a new car each, which features are deleted; `missed` is (passes, features)."""
    f, a, w = discounted(np.where(missed, 0.0, SURE), np.where(missed, SURE, 0.0), policy.trust, policy)
    who = np.broadcast_to(np.arange(len(missed))[:, None], missed.shape)
    return fold_histories(Histories(f, a, w, who), PRIOR, policy, deleted=True).standing


def _entered(standing: Flags) -> Flags:
    """Say at which passes a deletion begins to stand, (passes, features)."""
    return standing & ~np.vstack([np.zeros((1, standing.shape[1]), bool), standing[:-1]])


def false_deletions_of_a_fresh_map(miss_rate: float, policy: ClassPolicy, *, passes: int = 10) -> float:
    """Return the false deletions per 10⁴ passes in the first passes, exactly: over all courses that they can take."""
    missed = (np.arange(2**passes) >> np.arange(passes)[:, None]) % 2 == 1
    likely = np.where(missed, miss_rate, 1.0 - miss_rate).prod(axis=0)
    entered = _entered(_stands(missed, policy)).sum(axis=0)
    return float(entered @ likely) / passes * 1e4


def false_deletions(miss_rate: float, policy: ClassPolicy, *, passes: int, features: int, skip: int = 0) -> float:
    """Return the false deletions per 10⁴ passes in the passes after the first `skip`, by simulation."""
    missed = np.random.default_rng(11).random((skip + passes, features)) < miss_rate
    return int(_entered(_stands(missed, policy))[skip:].sum()) / (passes * features) * 1e4


def passes_to_deletion(
    policy: ClassPolicy, *, seen_before: int, features: int = 4_000, miss_rate: float = 0.05
) -> NDArray[np.intp]:
    """Return how many passes after its removal each feature, (features,), stands deleted; 5 % see something there."""
    rng = np.random.default_rng(12)
    missed = np.vstack([rng.random((seen_before, features)) < miss_rate, rng.random((40, features)) < 1.0 - miss_rate])
    course = _stands(missed, policy)[seen_before:]
    assert course.any(axis=0).all()
    return np.asarray(course.argmax(axis=0) + 1)


def test_many_features_side_by_side_fold_as_each_does_alone() -> None:
    rng = np.random.default_rng(13)
    features = []
    for odds in np.linspace(0.05, 0.9, 60):
        missed = rng.random(int(rng.integers(0, POLICY.window + 9))) < odds
        weights = zip(rng.uniform(0.0, 5.0, (len(missed), 2)).tolist(), missed.tolist(), strict=True)
        features.append(
            [
                PassEvidence(int(rng.integers(9)), 1800.0 * i, 0.1 * f if miss else f, a if miss else 0.1 * a)
                for i, ((f, a), miss) in enumerate(weights)
            ]
        )
    priors = rng.uniform(0.0, 4.0, len(features)).tolist()
    for side in Side:
        deleted = side is Side.DELETED
        together = fold_columns(columns(features), priors, POLICY, deleted=deleted).states()
        for state, passes, prior in zip(together, features, priors, strict=True):
            assert [state] == fold_columns(columns([passes]), [prior], POLICY, deleted=deleted).states()
            alone = fold(contributions(passes, POLICY), prior_weight=prior, policy=POLICY, side=side)
            assert state == dataclasses.replace(alone, steps=())
        assert {state.standing for state in together} == {True, False}


def test_every_step_of_a_feature_is_the_same_whatever_it_is_folded_with() -> None:
    rng = np.random.default_rng(14)
    missed = rng.random((70, 60)) < np.linspace(0.05, 0.9, 60)
    f, a = np.where(missed, 0.1, 1.0), np.where(missed, 1.0, 0.1)
    said = discounted(f * rng.uniform(0.0, 5.0, f.shape), a * rng.uniform(0.0, 5.0, a.shape), POLICY.trust, POLICY)
    who, priors = rng.integers(0, 9, f.shape), rng.uniform(0.0, 4.0, f.shape[1])
    for deleted in (False, True):
        together = fold_histories(Histories(*said, who), priors, POLICY, deleted=deleted)
        for number, prior in enumerate(priors):
            mine = Histories(*(each[:, [number]] for each in said), who[:, [number]])
            alone = fold_histories(mine, prior, POLICY, deleted=deleted)
            for name in ("weight_for", "weight_against", "standing"):
                assert (getattr(together, name)[:, number] == getattr(alone, name)[:, 0]).all()
        assert 0.0 < together.standing.mean() < 1.0


def test_few_false_deletions_while_the_map_is_fresh() -> None:
    assert false_deletions_of_a_fresh_map(0.05, POLICY) < 0.1


def test_few_false_deletions_in_the_long_run() -> None:
    assert false_deletions(0.05, POLICY, passes=60, features=20_000, skip=30) < 0.1
    assert false_deletions(0.10, POLICY, passes=60, features=20_000, skip=30) < 1.5


def test_a_threshold_that_three_misses_reach_would_break_the_goal() -> None:
    easier = dataclasses.replace(POLICY, enter=0.79)
    assert false_deletions_of_a_fresh_map(0.05, easier) > 0.1
    assert np.median(passes_to_deletion(easier, seen_before=30)) == np.median(
        passes_to_deletion(POLICY, seen_before=30)
    )


@pytest.mark.parametrize(("seen_before", "median", "late"), [(0, 4, 6), (30, 5, 7)])
def test_a_deletion_is_seen_in_about_five_passes(seen_before: int, median: int, late: int) -> None:
    delays = passes_to_deletion(POLICY, seen_before=seen_before)
    assert np.median(delays) == median
    assert np.quantile(delays, 0.95) <= late
