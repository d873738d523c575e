"""The law over columns: the passes of many features as arrays in, what each feature amounts to as arrays out.

What `contributions` and `fold` make of lists, without an object for each pass: a server folds thousands of features in
one go. The numbers come from the same `discounted` and `fold_histories`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.aggregation.course import Histories, discounted, fold_histories
from slamcu_core.aggregation.law import EPOCH_S
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


@dataclass(frozen=True, slots=True)
class FoldedColumns:
    """What the contributions of N features amount to."""

    weight_for: Array  # (N,), F
    weight_against: Array  # (N,), A
    standing: NDArray[np.bool_]  # (N,)
    contributors_for: Indices  # (N,)
    contributors_against: Indices  # (N,)
    last_informative: Array  # (N,), s of POSIX time, NaN where nothing has been informative
    folded: Indices  # (N,), contributions that folded, at most the policy's window
    oldest: Array  # (N,), s of POSIX time of the oldest of them, NaN where there is none


@dataclass(frozen=True, slots=True)
class _Contributions:
    """The contributions of all features, in order of feature and contributor."""

    feature: Indices
    code: Indices  # tells the contributors of one feature apart, from 0
    contributor: NDArray[np.int64]
    time: Array
    weight_for: Array  # discounted
    weight_against: Array
    informativeness: Array


def fold_columns(
    passes: PassColumns,
    prior_weight: ArrayLike,
    policy: ClassPolicy,
    *,
    deleted: bool,
    trust: ArrayLike | None = None,
) -> FoldedColumns:
    """Fold the passes of N features.

    Parameters
    ----------
    prior_weight : (N,), f of the map's prior of each feature (eq. 3); 0 for a candidate.
    deleted : whether absence is what stands; else existence.
    trust : (P,), α in [0, 1) of each pass's contributor; if not given the policy's, by what it knows of contributors.

    Raises EvidenceError where a weight or a prior is negative or not finite, or a trust out of its range.
    """
    priors = np.atleast_1d(np.asarray(prior_weight, float))
    _check(passes, trust)
    newest = _newest_informative(_contributions(passes, policy, trust), len(priors), policy)
    counts = np.bincount(newest.feature, minlength=len(priors))
    step = np.arange(len(newest.feature)) - np.repeat(np.cumsum(counts) - counts, counts)
    place, shape = (step, newest.feature), (int(counts.max(initial=0)), len(priors))

    def table(values: Array | Indices | NDArray[np.bool_]) -> Array:
        filled = np.zeros(shape)
        filled[place] = values
        return filled

    histories = Histories(
        table(newest.weight_for),
        table(newest.weight_against),
        table(newest.informativeness),
        table(newest.code).astype(np.intp),
        None if policy.trusts is None else table(policy.trusts.records(newest.contributor, newest.time)).astype(bool),
    )
    course = fold_histories(histories, priors, policy, deleted=deleted)
    times = np.full(len(priors), np.nan)
    times[newest.feature] = newest.time  # the last of each is written last
    oldest = np.full(len(priors), np.nan)
    oldest[newest.feature[::-1]] = newest.time[::-1]
    folds = shape[0] > 0
    return FoldedColumns(
        weight_for=course.weight_for[-1] if folds else priors.copy(),
        weight_against=course.weight_against[-1] if folds else np.zeros(len(priors)),
        standing=course.standing[-1] if folds else np.zeros(len(priors), bool),
        contributors_for=course.contributors_for,
        contributors_against=course.contributors_against,
        last_informative=times,
        folded=counts,
        oldest=oldest,
    )


def _contributions(passes: PassColumns, policy: ClassPolicy, trust: ArrayLike | None) -> _Contributions:
    """Sum the passes of each feature, contributor and epoch, and discount each sum once."""
    order = np.lexsort((passes.ended_at, passes.contributor, passes.feature))
    feature, contributor, time = passes.feature[order], passes.contributor[order], passes.ended_at[order]
    if not order.size:
        nothing = np.zeros(0)
        return _Contributions(feature, feature, contributor, nothing, nothing, nothing, nothing)
    epoch = np.floor(time / EPOCH_S)
    other_feature = np.diff(feature, prepend=feature[0] - 1) != 0
    other_contributor = other_feature | (np.diff(contributor, prepend=contributor[0]) != 0)
    begins = np.flatnonzero(other_contributor | (np.diff(epoch, prepend=epoch[0]) != 0))
    ends = np.append(begins[1:], order.size) - 1
    number = np.cumsum(other_contributor)
    code = number - np.repeat(number[other_feature], np.diff(np.append(np.flatnonzero(other_feature), order.size)))
    if trust is None and policy.trusts is not None:
        trust = policy.trust * policy.trusts.shares(passes.contributor)
    f, a, w = discounted(
        np.add.reduceat(passes.weight_for[order], begins),
        np.add.reduceat(passes.weight_against[order], begins),
        policy.trust if trust is None else np.broadcast_to(np.asarray(trust, float), order.shape)[order][begins],
        policy,
    )
    return _Contributions(feature[begins], code[begins], contributor[begins], time[ends], f, a, w)


def _newest_informative(items: _Contributions, features: int, policy: ClassPolicy) -> _Contributions:
    """Return of each feature the newest K that saw something, in order of feature, time, then contributor."""
    informative = np.flatnonzero(
        (items.informativeness > 0.0) & (items.informativeness >= policy.minimum_informativeness)
    )
    order = informative[np.lexsort((items.time[informative], items.feature[informative]))]
    counts = np.bincount(items.feature[order], minlength=features)
    left = np.repeat(np.cumsum(counts), counts) - np.arange(order.size)  # from here to the feature's last, 1 for that
    order = order[left <= policy.window]
    return _Contributions(
        items.feature[order],
        items.code[order],
        items.contributor[order],
        items.time[order],
        items.weight_for[order],
        items.weight_against[order],
        items.informativeness[order],
    )


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
