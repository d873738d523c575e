"""The law over columns: the passes of many features as arrays in, what each feature amounts to as arrays out.

What `contributions` and `fold` make of lists, without an object for each pass: a server folds thousands of features in
one go. The numbers come from the same `discounted` and `fold_histories`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.aggregation.course import Course, Histories, discounted, fold_histories
from slamcu_core.aggregation.doubt import heard
from slamcu_core.aggregation.law import EPOCH_S, FoldedState
from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.aggregation.trust import Trusts
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
            _times(self.last_informative),
            self.standing.tolist(),
            _times(self.stood_since),
            [()] * len(self.folded),
            self.folded.tolist(),
            _times(self.oldest),
            _times(self.turned_after),
            _times(self.turned_at),
            strict=True,
        )
        return [FoldedState(*row) for row in rows]


@dataclass(frozen=True, slots=True)
class _Contributions:
    """The contributions of all features, in order of feature, time, then contributor."""

    feature: Indices
    contributor: NDArray[np.int64]
    time: Array
    weight_for: Array  # discounted
    weight_against: Array
    informativeness: Array
    doubtful: NDArray[np.bool_] | None

    def take(self, chosen: Indices) -> _Contributions:
        """Return some of them."""
        return _Contributions(
            self.feature[chosen],
            self.contributor[chosen],
            self.time[chosen],
            self.weight_for[chosen],
            self.weight_against[chosen],
            self.informativeness[chosen],
            None if self.doubtful is None else self.doubtful[chosen],
        )


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
    window = _newest_informative(_contributions(passes, policy, trust), len(priors), policy)
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
    stood_since, turned_after, turned_at = _turns(course, histories, table(newest.time), counts)
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


def _turns(course: Course, histories: Histories, times: Array, counts: Indices) -> tuple[Array, Array, Array]:
    """Return since when each of N features stands, and between which contributions what A > F says came about."""
    since, after, at = (np.full(len(counts), np.nan) for _ in range(3))
    if not len(times):
        return since, after, at
    step = np.arange(len(times))[:, None]

    def begin(breaks: NDArray[np.bool_], end: Indices) -> Indices:
        """Return the step after the last before `end` at which something breaks."""
        return np.asarray(np.where(breaks & (step < end), step + 1, 0).max(axis=0, initial=0), np.intp)

    stands = np.flatnonzero(course.standing[-1])
    since[stands] = times[begin(~course.standing[:, stands], counts[stands]), stands]
    gone = np.flatnonzero(course.weight_against[-1] > course.weight_for[-1])
    run = begin(course.weight_against[:, gone] <= course.weight_for[:, gone], counts[gone])
    first = begin(histories.weight_for[:, gone] > histories.weight_against[:, gone], run)
    at[gone] = times[first, gone]
    denied = gone[first > 0]
    after[denied] = times[first[first > 0] - 1, denied]
    return since, after, at


def _times(seconds: Array) -> list[float | None]:
    return [each if each == each else None for each in seconds.tolist()]  # noqa: PLR0124  (NaN)


def _contributions(passes: PassColumns, policy: ClassPolicy, trust: ArrayLike | None) -> _Contributions:
    """Sum the passes of each feature, contributor and epoch, and discount each sum once."""
    if trust is None and policy.trusts is not None:
        trust = policy.trust * policy.trusts.shares(passes.contributor)
    alpha = np.broadcast_to(np.asarray(policy.trust if trust is None else trust, float), passes.feature.shape)
    if not _in_order(passes):
        order = np.lexsort((passes.contributor, passes.ended_at, passes.feature))
        passes, alpha = passes.take(order), alpha[order]
    summed, last = _summed(passes if passes.doubtful is None else _without_doubt(passes, passes.doubtful))
    return _Contributions(
        summed.feature,
        summed.contributor,
        summed.ended_at,
        *discounted(summed.weight_for, summed.weight_against, alpha if last is None else alpha[last], policy),
        summed.doubtful,
    )


def _heard(items: _Contributions, policy: ClassPolicy) -> _Contributions:
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


def _proven(items: _Contributions, trusts: Trusts) -> NDArray[np.bool_]:
    proven = trusts.records(items.contributor, items.time)
    return proven if items.doubtful is None else proven & ~items.doubtful


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


def _newest_informative(items: _Contributions, features: int, policy: ClassPolicy) -> _Contributions:
    """Return of each feature the newest K that saw something, in the same order."""
    informative = np.flatnonzero(
        (items.informativeness > 0.0) & (items.informativeness >= policy.minimum_informativeness)
    )
    counts = np.bincount(items.feature[informative], minlength=features)
    left = np.repeat(np.cumsum(counts), counts) - np.arange(informative.size)  # from here to the feature's last: 1
    order = informative[left <= policy.window]
    return items.take(order)


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
