"""The law by which the cloud folds what many cars report (design, section 2, "In the cloud").

Everything here is a pure function of a set: the order of arrival, batching and the number of workers cannot matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.errors import EvidenceError
from slamcu_core.evidence import masses_from_weights, weights_from_masses

EPOCH_S = 3600.0
"""Seconds of event time within which one contributor's passes count as one."""

_DAY_S = 86400.0


class Side(StrEnum):
    """What stands when evidence stands: a new feature (evidence for) or a deleted one (evidence against)."""

    NEW = "new"
    DELETED = "deleted"


@dataclass(frozen=True, slots=True)
class PassEvidence:
    """The evidence of one pass over one feature, without any prior."""

    contributor: int
    ended_at: float  # s of POSIX time
    weight_for: float  # f >= 0
    weight_against: float  # a >= 0


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one contributor's passes of one epoch are worth together, discounted once."""

    contributor: int
    epoch: int  # hours of POSIX time
    time: float  # s of POSIX time, end of the latest pass in it
    weight_for: float
    weight_against: float
    informativeness: float  # w in [0, 1]
    passes: int


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


def contributions(
    passes: Iterable[PassEvidence], policy: ClassPolicy, trust: Callable[[int], float] | None = None
) -> list[Contribution]:
    """Sum the passes of each contributor and epoch, and discount each sum once by the contributor's trust.

    The sums are exactly rounded, so that permutations of the passes give identical bits. The informativeness is
    w = (1 - u)/α with the policy's α: a contributor trusted less than that can neither say nor erase much.

    Parameters
    ----------
    passes : passes over one feature, without duplicates.
    trust : α in [0, 1) of a contributor; the policy's if not given.

    Returns
    -------
    Contributions in order of time, then contributor.

    Raises EvidenceError where a weight is negative or not finite, or a trust out of its range.
    """
    groups: dict[tuple[int, int], list[PassEvidence]] = {}
    for item in passes:
        if not (0.0 <= item.weight_for < math.inf and 0.0 <= item.weight_against < math.inf):
            raise EvidenceError(
                f"weights of evidence must be finite and at least 0, not {item.weight_for}, {item.weight_against}"
            )
        if not math.isfinite(item.ended_at):
            raise EvidenceError(f"the end of a pass must be a finite time, not {item.ended_at}")
        groups.setdefault((item.contributor, math.floor(item.ended_at / EPOCH_S)), []).append(item)
    if not groups:
        return []
    ordered = sorted((max(p.ended_at for p in group), *key) for key, group in groups.items())
    members = [groups[contributor, epoch] for _, contributor, epoch in ordered]
    alpha = np.array([_trust(contributor, policy, trust) for _, contributor, _ in ordered])
    e, n, u = masses_from_weights(
        [math.fsum(p.weight_for for p in group) for group in members],
        [math.fsum(p.weight_against for p in group) for group in members],
    )
    unknown = 1.0 - alpha + alpha * u
    f, a = weights_from_masses(alpha * e, alpha * n, unknown)
    informativeness = np.minimum(alpha * (1.0 - u) / policy.trust, 1.0)
    return [
        Contribution(contributor, epoch, time, *numbers, passes=len(group))
        for (time, contributor, epoch), numbers, group in zip(
            ordered, zip(f.tolist(), a.tolist(), informativeness.tolist(), strict=True), members, strict=True
        )
    ]


def fold(contributions: Iterable[Contribution], *, prior_weight: float, policy: ClassPolicy, side: Side) -> FoldedState:
    """Fold the newest K informative contributions: F ← γ^w F + f, A ← γ^w A + a, F from the prior, A from 0.

    Along the way the change stands from the moment that its mass reaches `enter` with enough different contributors
    until the mass falls below `leave`. A contributor is counted while at least `contributor_weight` of what it said
    on that side is left: misses that everyone has forgotten must not help one car to a quorum.

    Parameters
    ----------
    contributions : of one feature, in any order, one for each contributor and epoch.
    prior_weight : f of the map's prior, -ln(1 - λ_HD) (eq. 3); 0 for a candidate.
    side : whether existence (NEW) or absence (DELETED) is what stands.

    Raises EvidenceError if the prior is out of range or a contributor has two contributions in one epoch.
    """
    if not 0.0 <= prior_weight < math.inf:
        raise EvidenceError(f"the prior's weight must be finite and at least 0, not {prior_weight}")
    newest = _newest_informative(contributions, policy)
    F, A = float(prior_weight), 0.0
    course: list[tuple[float, float]] = []
    for item in newest:
        kept = policy.forgetting**item.informativeness
        F = kept * F + item.weight_for
        A = kept * A + item.weight_against
        course.append((F, A))
    if not newest:
        return FoldedState(F, A, 0, 0, None, standing=False, stood_since=None, steps=())

    counts_for, counts_against = _contributors(newest, policy)
    exists, not_exists, _ = masses_from_weights([f for f, _ in course], [a for _, a in course])
    if side is Side.NEW:
        mass, counts, quorum = exists, counts_for, policy.contributors_new
    else:
        mass, counts, quorum = not_exists, counts_against, policy.contributors_deleted
    steps: list[FoldStep] = []
    since: float | None = None
    for item, (f, a), m, count in zip(newest, course, mass.tolist(), counts.tolist(), strict=True):
        if since is None and m >= policy.enter and count >= quorum:
            since = item.time
        elif since is not None and m < policy.leave:
            since = None
        steps.append(FoldStep(item.time, item.contributor, f, a, standing=since is not None))
    return FoldedState(
        weight_for=F,
        weight_against=A,
        contributors_for=int(counts_for[-1]),
        contributors_against=int(counts_against[-1]),
        last_informative=newest[-1].time,
        standing=since is not None,
        stood_since=since,
        steps=tuple(steps),
    )


def decayed(state: FoldedState, as_of: float, policy: ClassPolicy) -> tuple[float, float]:
    """Return F and A as they read at a POSIX time: halved for each half-life since the last informative contribution.

    A prior that nobody has looked at does not decay, and nothing decays backwards.
    """
    if state.last_informative is None:
        return state.weight_for, state.weight_against
    age_days = max(as_of - state.last_informative, 0.0) / _DAY_S
    kept = 0.5 ** (age_days / policy.half_life_days)
    return kept * state.weight_for, kept * state.weight_against


def _trust(contributor: int, policy: ClassPolicy, trust: Callable[[int], float] | None) -> float:
    if trust is None:
        return policy.trust
    alpha = float(trust(contributor))
    if not 0.0 <= alpha < 1.0:
        raise EvidenceError(f"the trust of contributor {contributor} must lie in [0, 1), not {alpha}")
    return alpha


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


def _contributors(newest: Sequence[Contribution], policy: ClassPolicy) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Count after each step, shape (K,), the contributors whose weight for and against is still in the fold."""
    forgotten = np.cumsum([item.informativeness for item in newest])
    left = np.tril(policy.forgetting ** np.maximum(forgotten[:, None] - forgotten, 0.0))
    _, who = np.unique([item.contributor for item in newest], return_inverse=True)
    mine = who[:, None] == np.arange(who.max() + 1)

    def count(weights: list[float]) -> NDArray[np.intp]:
        remaining = left @ (np.array(weights)[:, None] * mine)
        return np.asarray(np.count_nonzero(remaining >= policy.contributor_weight, axis=1), np.intp)

    return count([item.weight_for for item in newest]), count([item.weight_against for item in newest])
