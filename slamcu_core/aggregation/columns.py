"""The law over columns: the passes of many features as arrays in, what each feature amounts to as arrays out.

What `contributions` and `fold` make of lists, without an object for each pass: a server folds thousands of features in
one go. The numbers come from the same `discounted`, `heard`, `fold_histories` and `turns`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.aggregation.contribution_columns import ContributionColumns, PassColumns, contribution_columns
from slamcu_core.aggregation.course import Histories, fold_histories, moments, turns
from slamcu_core.aggregation.doubt import heard
from slamcu_core.aggregation.law import FoldedState
from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.aggregation.trust import Trusts

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class FoldedColumns:
    """What the contributions of N features amount to."""

    weight_for: Array  # (N,), F
    weight_against: Array  # (N,), A
    standing: NDArray[np.bool_]  # (N,)
    contributors_for: Indices  # (N,)
    contributors_against: Indices  # (N,)
    last_informative: Array  # (N,), s of POSIX time, NaN where nothing has been informative
    folded: Indices  # (N,), informative contributions in the window, at most the policy's, also such as are not heard
    oldest: Array  # (N,), s of POSIX time of the oldest of them, NaN where there is none
    stood_since: Array  # (N,), s of POSIX time within the window, NaN where it does not stand
    turned_after: Array  # (N,), as `FoldedState` has it, NaN for nobody
    turned_at: Array  # (N,)

    def states(self) -> list[FoldedState]:
        """Return each by itself, without its course."""
        rows = zip(
            self.weight_for.tolist(),
            self.weight_against.tolist(),
            self.contributors_for.tolist(),
            self.contributors_against.tolist(),
            moments(self.last_informative),
            self.standing.tolist(),
            moments(self.stood_since),
            [()] * len(self.folded),
            self.folded.tolist(),
            moments(self.oldest),
            moments(self.turned_after),
            moments(self.turned_at),
            strict=True,
        )
        return [FoldedState(*row) for row in rows]


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
    window = _newest_informative(contribution_columns(passes, policy, trust), len(priors), policy)
    newest = _heard(window, policy)
    counts = np.bincount(newest.feature, minlength=len(priors))
    step = np.arange(len(newest.feature)) - np.repeat(np.cumsum(counts) - counts, counts)
    shape = (int(counts.max(initial=0)), len(priors))
    place = step * len(priors) + newest.feature

    def table(values: NDArray[Any], kind: type = float) -> NDArray[Any]:
        filled: NDArray[Any] = np.zeros(shape, kind)
        filled.ravel()[place] = values
        return filled

    histories = Histories(
        table(newest.weight_for),
        table(newest.weight_against),
        table(newest.informativeness),
        table(_codes(newest.feature, newest.contributor), np.intp),
        None if policy.trusts is None else table(_proven(newest, policy.trusts), bool),
    )
    course = fold_histories(histories, priors, policy, deleted=deleted)
    times = np.full(len(priors), np.nan)
    times[newest.feature] = newest.time  # the last of each is written last
    oldest = np.full(len(priors), np.nan)
    oldest[window.feature[::-1]] = window.time[::-1]
    folds = shape[0] > 0
    stood_since, turned_after, turned_at = turns(course, histories, table(newest.time), counts)
    return FoldedColumns(
        weight_for=course.weight_for[-1] if folds else priors.copy(),
        weight_against=course.weight_against[-1] if folds else np.zeros(len(priors)),
        standing=course.standing[-1] if folds else np.zeros(len(priors), bool),
        contributors_for=course.contributors_for,
        contributors_against=course.contributors_against,
        last_informative=times,
        folded=np.bincount(window.feature, minlength=len(priors)),
        oldest=oldest,
        stood_since=stood_since,
        turned_after=turned_after,
        turned_at=turned_at,
    )


def _heard(items: ContributionColumns, policy: ClassPolicy) -> ContributionColumns:
    if items.doubtful is None:
        return items
    return items.take(
        np.flatnonzero(
            heard(
                items.feature,
                items.contributor,
                weight_for=items.weight_for,
                weight_against=items.weight_against,
                informativeness=items.informativeness,
                doubtful=items.doubtful,
                policy=policy,
            )
        )
    )


def _proven(items: ContributionColumns, trusts: Trusts) -> NDArray[np.bool_]:
    proven = trusts.records(items.contributor, items.time)
    return proven if items.doubtful is None else proven & ~items.doubtful


def _codes(feature: Indices, contributor: NDArray[np.int64]) -> Indices:
    """Return numbers from 0 that tell the contributors of one feature apart."""
    if not len(feature):
        return feature
    number, count = contributor - contributor.min(), int(contributor.max()) - int(contributor.min()) + 1
    if count > 2**62 // (int(feature[-1]) + 1):
        number, count = np.unique(contributor, return_inverse=True)[1], len(feature)
    key = feature * count + number
    order = np.argsort(key)
    feature, key = feature[order], key[order]
    fresh = np.diff(key, prepend=-1) != 0
    begins = np.flatnonzero(np.diff(feature, prepend=-1) != 0)
    so_far = np.cumsum(fresh) - 1
    codes = np.empty(len(order), np.intp)
    codes[order] = so_far - np.repeat(so_far[begins], np.diff(np.append(begins, len(order))))
    return codes


def _newest_informative(items: ContributionColumns, features: int, policy: ClassPolicy) -> ContributionColumns:
    """Return of each feature the newest K that saw something, in the same order."""
    informative = np.flatnonzero(
        (items.informativeness > 0.0) & (items.informativeness >= policy.minimum_informativeness)
    )
    counts = np.bincount(items.feature[informative], minlength=features)
    left = np.repeat(np.cumsum(counts), counts) - np.arange(informative.size)  # from here to the feature's last: 1
    order = informative[left <= policy.window]
    return items.take(order)
