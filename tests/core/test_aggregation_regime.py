"""The regime of the policy's start values: false deletions against passes to a decision.

Run the three functions with other arguments to choose other values; the table in `slamcu_core/aggregation/policy.py`
holds what they gave.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from slamcu_core.aggregation import ClassPolicy, PassEvidence, Side, contributions, fold
from slamcu_core.evidence import masses_from_weights, support

POLICY = ClassPolicy()
PRIOR = float(support(0.95))
SURE = 40.0


def _stands(missed: NDArray[np.bool_], policy: ClassPolicy) -> Iterator[NDArray[np.bool_]]:
    """Say after each full pass, by a new car each, which features are deleted; `missed` is (passes, features)."""
    worth = -np.log1p(-policy.trust)
    F, A = np.full(missed.shape[1], PRIOR), np.zeros(missed.shape[1])
    standing = np.zeros(missed.shape[1], bool)
    counts_for = int(np.log(policy.contributor_weight / worth) / np.log(policy.forgetting)) + 1  # passes
    for step, miss in enumerate(missed):
        F, A = policy.forgetting * F + worth * ~miss, policy.forgetting * A + worth * miss
        quorum = missed[max(step + 1 - counts_for, 0) : step + 1].sum(axis=0) >= policy.contributors_deleted
        _, mass, _ = masses_from_weights(F, A)
        standing = (standing | ((mass >= policy.enter) & quorum)) & (mass >= policy.leave)
        yield standing


def false_deletions_of_a_fresh_map(miss_rate: float, policy: ClassPolicy, *, passes: int = 10) -> float:
    """Return the false deletions per 10⁴ passes in the first passes, exactly: over all courses that they can take."""
    missed = (np.arange(2**passes) >> np.arange(passes)[:, None]) % 2 == 1
    likely = np.where(missed, miss_rate, 1.0 - miss_rate).prod(axis=0)
    standing = np.array([np.zeros(2**passes, bool), *_stands(missed, policy)])
    entered = (standing[1:] & ~standing[:-1]).sum(axis=0)
    return float(entered @ likely) / passes * 1e4


def false_deletions(miss_rate: float, policy: ClassPolicy, *, passes: int, features: int, skip: int = 0) -> float:
    """Return the false deletions per 10⁴ passes in the passes after the first `skip`, by simulation."""
    missed = np.random.default_rng(11).random((skip + passes, features)) < miss_rate
    before, entered = np.zeros(features, bool), 0
    for step, standing in enumerate(_stands(missed, policy)):
        entered += int((standing & ~before).sum()) if step >= skip else 0
        before = standing
    return entered / (passes * features) * 1e4


def passes_to_deletion(
    policy: ClassPolicy, *, seen_before: int, features: int = 4_000, miss_rate: float = 0.05
) -> NDArray[np.intp]:
    """Return how many passes after its removal each feature, (features,), stands deleted; 5 % see something there."""
    rng = np.random.default_rng(12)
    missed = np.vstack([rng.random((seen_before, features)) < miss_rate, rng.random((40, features)) < 1.0 - miss_rate])
    course = np.array(list(_stands(missed, policy)))[seen_before:]
    assert course.any(axis=0).all()
    return np.asarray(course.argmax(axis=0) + 1)


def test_the_vectorised_law_is_the_law() -> None:
    missed = np.random.default_rng(13).random((POLICY.window, 60)) < np.linspace(0.05, 0.9, 60)
    course = np.array(list(_stands(missed, POLICY)))
    for feature in range(missed.shape[1]):
        passes = [
            PassEvidence(i, 3600.0 * i, 0.0 if miss else SURE, SURE if miss else 0.0)
            for i, miss in enumerate(missed[:, feature].tolist())
        ]
        state = fold(contributions(passes, POLICY), prior_weight=PRIOR, policy=POLICY, side=Side.DELETED)
        assert [step.standing for step in state.steps] == course[:, feature].tolist()
    assert course.any()
    assert not course.all()


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
