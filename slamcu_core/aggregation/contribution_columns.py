"""Contributions as columns: the passes of many features as arrays in, and what `contributions` makes of them out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.aggregation.contributions import EPOCH_S
from slamcu_core.aggregation.course import discounted
from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.errors import EvidenceError

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class PassColumns:
    """P passes over N features of one class."""

    feature: Indices  # (P,), from 0 to N - 1
    contributor: NDArray[np.int64]  # (P,)
    ended_at: Array  # (P,), s of POSIX time
    weight_for: Array  # (P,), f >= 0
    weight_against: Array  # (P,), a >= 0
    doubtful: NDArray[np.bool_] | None = None  # (P,), whether the filter was not to be trusted; None: nobody's was

    def take(self, chosen: Indices) -> PassColumns:
        """Return some of the passes, given by their numbers."""
        return PassColumns(
            self.feature[chosen],
            self.contributor[chosen],
            self.ended_at[chosen],
            self.weight_for[chosen],
            self.weight_against[chosen],
            None if self.doubtful is None else self.doubtful[chosen],
        )


@dataclass(frozen=True, slots=True)
class ContributionColumns:
    """The contributions of all features, in order of feature, time, then contributor."""

    feature: Indices
    contributor: NDArray[np.int64]
    time: Array
    weight_for: Array  # discounted
    weight_against: Array
    informativeness: Array
    doubtful: NDArray[np.bool_] | None

    def take(self, chosen: Indices) -> ContributionColumns:
        """Return some of them."""
        return ContributionColumns(
            self.feature[chosen],
            self.contributor[chosen],
            self.time[chosen],
            self.weight_for[chosen],
            self.weight_against[chosen],
            self.informativeness[chosen],
            None if self.doubtful is None else self.doubtful[chosen],
        )


def contribution_columns(passes: PassColumns, policy: ClassPolicy, trust: ArrayLike | None) -> ContributionColumns:
    """Sum the passes of each feature, contributor and epoch, and discount each sum once.

    Raises EvidenceError where a weight is negative or not finite, or a trust (of each pass) out of its range.
    """
    _check(passes, trust)
    if trust is None and policy.trusts is not None:
        trust = policy.trust * policy.trusts.shares(passes.contributor)
    alpha = np.broadcast_to(np.asarray(policy.trust if trust is None else trust, float), passes.feature.shape)
    if not _in_order(passes):
        order = np.lexsort((passes.contributor, passes.ended_at, passes.feature))
        passes, alpha = passes.take(order), alpha[order]
    summed, last = _summed(passes if passes.doubtful is None else _without_doubt(passes, passes.doubtful))
    return ContributionColumns(
        summed.feature,
        summed.contributor,
        summed.ended_at,
        *discounted(summed.weight_for, summed.weight_against, alpha if last is None else alpha[last], policy),
        summed.doubtful,
    )


def _without_doubt(passes: PassColumns, doubtful: NDArray[np.bool_]) -> PassColumns:
    """Take the weights from what was said in doubt by who said something without it in the same epoch.

    What says nothing is not in doubt afterwards, and all of one contributor and epoch that speaks is, or nothing.
    """
    speaks = (passes.weight_for > 0.0) | (passes.weight_against > 0.0)
    doubtful = doubtful & speaks
    epoch = np.floor(passes.ended_at / EPOCH_S).astype(np.int64)
    # in order of feature and time, so those of one epoch stand together: few have anything in doubt
    block = np.cumsum((np.diff(passes.feature, prepend=-1) != 0) | (np.diff(epoch, prepend=0) != 0))
    few = np.flatnonzero(np.bincount(block, doubtful)[block] > 0)
    _, group = np.unique(np.stack([block[few], passes.contributor[few]]), axis=1, return_inverse=True)
    without = np.bincount(group.ravel(), (speaks & ~doubtful)[few]) > 0
    silent = np.zeros(len(doubtful), bool)
    silent[few] = doubtful[few] & without[group.ravel()]
    return PassColumns(
        passes.feature,
        passes.contributor,
        passes.ended_at,
        np.where(silent, 0.0, passes.weight_for),
        np.where(silent, 0.0, passes.weight_against),
        doubtful & ~silent,
    )


def _in_order(passes: PassColumns) -> bool:
    """Say whether passes come in order of feature, time, then contributor."""
    feature, time, contributor = (np.diff(each) for each in (passes.feature, passes.ended_at, passes.contributor))
    wrong = (feature < 0) | ((feature == 0) & ((time < 0.0) | ((time == 0.0) & (contributor < 0))))
    return not wrong.any()


def _summed(passes: PassColumns) -> tuple[PassColumns, Indices | None]:
    """Sum what each contributor said of a feature within an epoch; its time is that of the latest pass.

    Both are in order of feature, time, then contributor. So what may be one contribution stands together, and is
    little. The second is which passes were the latest; None if all were.
    """
    epoch = np.floor(passes.ended_at / EPOCH_S)
    follows = (np.diff(passes.feature) == 0) & (np.diff(epoch) == 0)
    if not follows.any():
        return passes, None
    crowded = np.append(follows, False) | np.append(False, follows)
    mine = np.flatnonzero(crowded)
    mine = mine[np.lexsort((passes.ended_at[mine], passes.contributor[mine], epoch[mine], passes.feature[mine]))]
    group = passes.take(mine)
    other = (np.diff(group.feature) != 0) | (np.diff(epoch[mine]) != 0) | (np.diff(group.contributor) != 0)
    begins = np.flatnonzero(np.append(True, other))
    last = mine[np.append(begins[1:], len(mine)) - 1]
    weight_for, weight_against = passes.weight_for.copy(), passes.weight_against.copy()
    weight_for[last] = np.add.reduceat(group.weight_for, begins)
    weight_against[last] = np.add.reduceat(group.weight_against, begins)
    doubtful = passes.doubtful
    if doubtful is not None and group.doubtful is not None:
        doubtful = doubtful.copy()
        doubtful[last] = np.logical_or.reduceat(group.doubtful, begins)
    kept = ~crowded
    kept[last] = True
    table = PassColumns(passes.feature, passes.contributor, passes.ended_at, weight_for, weight_against, doubtful)
    return table.take(np.flatnonzero(kept)), np.flatnonzero(kept)


def _check(passes: PassColumns, trust: ArrayLike | None) -> None:
    for name, weights in (("for", passes.weight_for), ("against", passes.weight_against)):
        bad = ~(np.isfinite(weights) & (weights >= 0.0))
        if bad.any():
            raise EvidenceError(f"weights of evidence must be finite and at least 0, not {weights[bad][0]} {name}")
    if not np.isfinite(passes.ended_at).all():
        raise EvidenceError("the end of a pass must be a finite time")
    alpha = np.asarray(0.0 if trust is None else trust, float)
    if not ((alpha >= 0.0) & (alpha < 1.0)).all():
        raise EvidenceError("the trust of every contributor must lie in [0, 1)")
