"""The law by which the cloud folds what many cars report (design, section 2, "In the cloud").

Everything here is a pure function of a set: the order of arrival, batching and the number of workers cannot matter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import compress

import numpy as np

from slamcu_core.aggregation.contributions import Contribution
from slamcu_core.aggregation.course import Histories, fold_histories, moments, turns
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
    window = _newest_informative(contributions, policy)
    items = _heard(window, policy)
    histories = _histories(items, policy)
    course = fold_histories(histories, [prior_weight], policy, deleted=side is Side.DELETED)
    times = np.array([item.time for item in items], float).reshape(-1, 1)
    since, turned_after, turned_at = (
        moments(each)[0] for each in turns(course, histories, times, np.array([len(items)]))
    )
    told = (each[:, 0].tolist() for each in (course.weight_for, course.weight_against, course.standing))
    steps = tuple(FoldStep(item.time, item.contributor, *step) for item, *step in zip(items, *told, strict=True))
    return FoldedState(
        weight_for=steps[-1].weight_for if steps else float(prior_weight),
        weight_against=steps[-1].weight_against if steps else 0.0,
        contributors_for=int(course.contributors_for[0]),
        contributors_against=int(course.contributors_against[0]),
        last_informative=steps[-1].time if steps else None,
        standing=since is not None,
        stood_since=since,
        steps=steps,
        folded=len(window),
        oldest=window[0].time if window else None,
        turned_after=turned_after,
        turned_at=turned_at,
    )


def _heard(window: Sequence[Contribution], policy: ClassPolicy) -> list[Contribution]:
    """Return those of the newest contributions that fold."""
    folds = heard(
        np.zeros(len(window), np.intp),
        np.array([item.contributor for item in window], np.int64),
        weight_for=np.array([item.weight_for for item in window]),
        weight_against=np.array([item.weight_against for item in window]),
        informativeness=np.array([item.informativeness for item in window]),
        doubtful=np.array([item.doubtful for item in window], bool),
        policy=policy,
    )
    return list(compress(window, folds.tolist()))


def _histories(items: Sequence[Contribution], policy: ClassPolicy) -> Histories:
    """Return the contributions of one feature as arrays, (K, 1)."""
    codes: dict[int, int] = {}
    proven = None
    if policy.trusts is not None:
        records = policy.trusts.records([item.contributor for item in items], [item.time for item in items])
        # whoever doubts speaks without a record
        proven = (records & ~np.array([item.doubtful for item in items], bool)).reshape(-1, 1)
    return Histories(
        np.array([item.weight_for for item in items], float).reshape(-1, 1),
        np.array([item.weight_against for item in items], float).reshape(-1, 1),
        np.array([item.informativeness for item in items], float).reshape(-1, 1),
        np.array([codes.setdefault(item.contributor, len(codes)) for item in items], np.intp).reshape(-1, 1),
        proven,
    )


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
