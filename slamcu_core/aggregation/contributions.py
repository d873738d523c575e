"""What many cars report of a feature, made into contributions: one contributor's passes of one epoch, discounted once.

Pure functions of a set, like the law that folds them (`law`). Over arrays: `contribution_columns`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.course import discounted
from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.errors import EvidenceError

EPOCH_S = 3600.0
"""Seconds of event time within which one contributor's passes count as one."""


@dataclass(frozen=True, slots=True)
class PassEvidence:
    """The evidence of one pass over one feature, without any prior."""

    contributor: int
    ended_at: float  # s of POSIX time
    weight_for: float  # f >= 0
    weight_against: float  # a >= 0
    doubtful: bool = False  # whether the filter said that it is not to be trusted


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
    doubtful: bool = False  # it folds only if others in doubt agree (`heard`)


def contributions(
    passes: Iterable[PassEvidence], policy: ClassPolicy, trust: Callable[[int], float] | None = None
) -> list[Contribution]:
    """Sum the passes of each contributor and epoch, and discount each sum once by the contributor's trust.

    The sums are exactly rounded, so that permutations of the passes give identical bits. The informativeness is
    w = (1 - u)/α with the policy's α: a contributor trusted less than that can neither say nor erase much. What a
    contributor said in doubt counts for nothing in an epoch in which it said something without.

    Parameters
    ----------
    passes : passes over one feature, without duplicates.
    trust : α in [0, 1) of a contributor; if not given the policy's, by what it knows of contributors.

    Returns
    -------
    Contributions in order of time, then contributor.

    Raises EvidenceError where a weight is negative or not finite, or a trust out of its range.
    """
    groups = _by_contributor_and_epoch(passes)
    ordered = sorted((max(p.ended_at for p in group), *key) for key, group in groups.items())
    members = [groups[contributor, epoch] for _, contributor, epoch in ordered]
    spoken = [group if _in_doubt(group) else [p for p in group if not p.doubtful] for group in members]
    numbers = discounted(
        [math.fsum(p.weight_for for p in group) for group in spoken],
        [math.fsum(p.weight_against for p in group) for group in spoken],
        _trust([contributor for _, contributor, _ in ordered], policy, trust),
        policy,
    )
    return [
        Contribution(contributor, epoch, time, f, a, w, passes=len(group), doubtful=_in_doubt(group))
        for (time, contributor, epoch), f, a, w, group in zip(
            ordered, *(each.tolist() for each in numbers), members, strict=True
        )
    ]


def _in_doubt(group: Sequence[PassEvidence]) -> bool:
    """Whether all that a contributor said within an epoch it said in doubt."""
    return any(p.doubtful for p in group) and not any(
        p.weight_for > 0.0 or p.weight_against > 0.0 for p in group if not p.doubtful
    )


def _by_contributor_and_epoch(passes: Iterable[PassEvidence]) -> dict[tuple[int, int], list[PassEvidence]]:
    groups: dict[tuple[int, int], list[PassEvidence]] = {}
    for item in passes:
        if not (0.0 <= item.weight_for < math.inf and 0.0 <= item.weight_against < math.inf):
            raise EvidenceError(
                f"weights of evidence must be finite and at least 0, not {item.weight_for}, {item.weight_against}"
            )
        if not math.isfinite(item.ended_at):
            raise EvidenceError(f"the end of a pass must be a finite time, not {item.ended_at}")
        groups.setdefault((item.contributor, math.floor(item.ended_at / EPOCH_S)), []).append(item)
    return groups


def _trust(
    contributors: Sequence[int], policy: ClassPolicy, trust: Callable[[int], float] | None
) -> NDArray[np.float64]:
    if trust is None:
        return policy.trust * (
            np.ones(len(contributors)) if policy.trusts is None else policy.trusts.shares(contributors)
        )
    for contributor in contributors:
        if not 0.0 <= trust(contributor) < 1.0:
            raise EvidenceError(f"the trust of contributor {contributor} must lie in [0, 1), not {trust(contributor)}")
    return np.array([trust(contributor) for contributor in contributors], float)
