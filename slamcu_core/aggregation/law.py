"""The law by which the cloud folds what many cars report (design, section 2, "In the cloud").

Everything here is a pure function of a set: the order of arrival, batching and the number of workers cannot matter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from slamcu_core.aggregation.contributions import Contribution
from slamcu_core.aggregation.course import Course, Histories, fold_histories
from slamcu_core.aggregation.doubt import heard
from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.errors import EvidenceError


class Side(StrEnum):
    """What stands when evidence stands: a new feature (evidence for) or a deleted one (evidence against)."""

    NEW = "new"
    DELETED = "deleted"


@dataclass(frozen=True, slots=True)
class FoldStep:
    """The state right after one contribution."""

    time: float
    contributor: int
    weight_for: float  # F
    weight_against: float  # A
    standing: bool


@dataclass(frozen=True, slots=True)
class FoldedState:
    """What a feature's contributions amount to."""

    weight_for: float  # F
    weight_against: float  # A
    contributors_for: int  # different contributors whose evidence for the feature still weighs
    contributors_against: int
    last_informative: float | None  # s of POSIX time
    standing: bool
    stood_since: float | None  # s of POSIX time within the window, None if it does not stand
    steps: tuple[FoldStep, ...]
    folded: int = 0  # informative contributions in the window, at most the policy's, also such as are not heard
    oldest: float | None = None  # s of POSIX time of the oldest of them
    turned_after: float | None = None  # s of POSIX time, last to deny what A > F says; None: nobody in the window
    turned_at: float | None = None  # s of POSIX time, the first to say it after that; None: F >= A now


def fold(contributions: Iterable[Contribution], *, prior_weight: float, policy: ClassPolicy, side: Side) -> FoldedState:
    """Fold the newest K informative contributions: F ← γ^w F + f, A ← γ^w A + a, F from the prior, A from 0.

    What was said in doubt is one of the K, and folds if it is `heard`: which of them do depends on nothing older.
    Along the way the change stands from the moment that its mass reaches `enter` with enough different contributors
    until the mass is below `leave` with enough of them on the other side. A contributor is counted while at least
    `contributor_weight` of what it said on that side is left: misses that everyone has forgotten must not help one car
    to a quorum; nor what two others have refuted since, or anybody, where nobody who speaks for a change has a record.

    Parameters
    ----------
    contributions : of one feature, in any order, one for each contributor and epoch.
    prior_weight : f of the map's prior, -ln(1 - λ_HD) (eq. 3); 0 for a candidate.
    side : whether existence (NEW) or absence (DELETED) is what stands.

    Raises EvidenceError if the prior is out of range or a contributor has two contributions in one epoch.
    """
    (state,) = fold_each([contributions], prior_weights=[prior_weight], policy=policy, side=side, with_steps=True)
    return state


def fold_each(
    features: Iterable[Iterable[Contribution]],
    *,
    prior_weights: Iterable[float],
    policy: ClassPolicy,
    side: Side,
    with_steps: bool = False,
) -> list[FoldedState]:
    """Fold the contributions of many features of one class at once: what `fold` says of each, in less time.

    Parameters
    ----------
    features : the contributions of each.
    prior_weights : one for each feature.
    with_steps : whether the states tell their course; otherwise their `steps` are empty.
    """
    newest = [_newest_informative(each, policy) for each in features]
    priors = np.array(list(prior_weights), float)
    if len(priors) != len(newest):
        raise EvidenceError(f"{len(newest)} features need as many priors, not {len(priors)}")
    folding = _heard(newest, policy)
    course = fold_histories(_histories(folding, policy), priors, policy, deleted=side is Side.DELETED)
    return [
        replace(
            _state(items, course, feature, prior, with_steps=with_steps),
            folded=len(window),
            oldest=window[0].time if window else None,
        )
        for feature, (items, window, prior) in enumerate(zip(folding, newest, priors.tolist(), strict=True))
    ]


def _heard(newest: Sequence[Sequence[Contribution]], policy: ClassPolicy) -> list[Sequence[Contribution]]:
    """Return of each feature's newest contributions those that fold."""
    doubted = [number for number, items in enumerate(newest) if any(item.doubtful for item in items)]
    folding = list(newest)
    if not doubted:
        return folding
    flat = [item for number in doubted for item in newest[number]]
    told = iter(
        heard(
            np.repeat(np.arange(len(doubted)), [len(newest[number]) for number in doubted]),
            np.array([item.contributor for item in flat], np.int64),
            weight_for=np.array([item.weight_for for item in flat]),
            weight_against=np.array([item.weight_against for item in flat]),
            informativeness=np.array([item.informativeness for item in flat]),
            doubtful=np.array([item.doubtful for item in flat]),
            policy=policy,
        ).tolist()
    )
    for number in doubted:
        folding[number] = [item for item in newest[number] if next(told)]
    return folding


def _histories(newest: Sequence[Sequence[Contribution]], policy: ClassPolicy) -> Histories:
    """Return the contributions of N features as arrays of as many steps as the longest has."""
    shape = max(map(len, newest), default=0), len(newest)
    f, a, w = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    who = np.zeros(shape, np.intp)
    proven = np.zeros(shape, bool)
    for feature, items in enumerate(newest):
        codes: dict[int, int] = {}
        for step, item in enumerate(items):
            f[step, feature], a[step, feature] = item.weight_for, item.weight_against
            w[step, feature] = item.informativeness
            who[step, feature] = codes.setdefault(item.contributor, len(codes))
        if policy.trusts is not None:
            proven[: len(items), feature] = policy.trusts.records(
                [item.contributor for item in items], [item.time for item in items]
            ) & ~np.array([item.doubtful for item in items], bool)  # whoever doubts speaks without a record
    return Histories(f, a, w, who, None if policy.trusts is None else proven)


def _state(
    items: Sequence[Contribution], course: Course, feature: int, prior: float, *, with_steps: bool
) -> FoldedState:
    if not items:
        return FoldedState(prior, 0.0, 0, 0, None, standing=False, stood_since=None, steps=())
    last = len(items) - 1
    F, A = course.weight_for[: last + 1, feature].tolist(), course.weight_against[: last + 1, feature].tolist()
    standing = course.standing[: last + 1, feature].tolist()
    since = None
    if standing[last]:
        begin = last
        while begin > 0 and standing[begin - 1]:
            begin -= 1
        since = items[begin].time
    turned_after, turned_at = _turn(items, F, A)
    steps = zip(items, F, A, standing, strict=True) if with_steps else ()
    return FoldedState(
        weight_for=F[last],
        weight_against=A[last],
        contributors_for=int(course.contributors_for[feature]),
        contributors_against=int(course.contributors_against[feature]),
        last_informative=items[last].time,
        standing=since is not None,
        stood_since=since,
        steps=tuple(FoldStep(item.time, item.contributor, f, a, stands) for item, f, a, stands in steps),
        turned_after=turned_after,
        turned_at=turned_at,
    )


def _turn(items: Sequence[Contribution], F: Sequence[float], A: Sequence[float]) -> tuple[float | None, float | None]:
    """Return between which contributions what A > F says came about: the last that denied it, and the one after.

    (None, None) if F >= A now; (None, time) if nothing in the window denied it.
    """
    step = len(items)
    while step > 0 and A[step - 1] > F[step - 1]:
        step -= 1
    if step == len(items):
        return None, None
    while step > 0 and items[step - 1].weight_for <= items[step - 1].weight_against:
        step -= 1
    return (items[step - 1].time if step else None), items[step].time


def _newest_informative(contributions: Iterable[Contribution], policy: ClassPolicy) -> list[Contribution]:
    """Return the newest K contributions that saw something, in order of time, then contributor."""
    ordered = sorted(contributions, key=lambda item: (item.time, item.contributor, item.epoch))
    if len({(item.contributor, item.epoch) for item in ordered}) != len(ordered):
        raise EvidenceError("a contributor has two contributions in one epoch: its passes must be summed first")
    informative = [
        item
        for item in ordered
        if item.informativeness > 0.0 and item.informativeness >= policy.minimum_informativeness
    ]
    return informative[-policy.window :]
