"""Why a change is believed: its contributions, how they folded, and what would turn it. Pure functions of passes."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np

from slamcu_core.aggregation import (
    EPOCH_S,
    ClassPolicy,
    Contribution,
    FoldedState,
    PassEvidence,
    Side,
    contributions,
    decayed,
    fades_at,
    fold,
)
from slamcu_server.accounts.times import TimesTold
from slamcu_server.aggregation.evidence import covariances, frame_at, fuse_place, moment, witnesses
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.changes.document import evidence, timestamp

_PSEUDONYM_DIGITS = 12
_FULL_WEIGHT = 20.0  # of a pass that leaves no doubt: what the discount leaves of it is -ln(1 - α)


@dataclass(frozen=True, slots=True)
class Case:
    """The evidence about one change."""

    passes: Sequence[StoredPass]
    side: Side
    prior_weight: float
    policy: ClassPolicy
    lon: float  # degrees, of the place from which residuals count
    lat: float
    covariance_m2: tuple[float, float, float]  # of that place


def pseudonym(salt: bytes, contributor: int) -> str:
    """Return the name of a contributor within one change: nobody can tell it again in another."""
    return hmac.new(salt, str(contributor).encode(), hashlib.sha256).hexdigest()[:_PSEUDONYM_DIGITS]


def explain(case: Case, salt: bytes, as_of: datetime, times: TimesTold) -> dict[str, Any]:
    """Return the evidence behind a change as of a time: contributions, F and A after each, and what would flip it.

    Passes that ended later are left out; what is there is decayed to that time.
    """
    now = as_of.timestamp()
    case = replace(case, passes=[item for item in case.passes if item.ended_at <= as_of])
    parts = contributions([item.evidence for item in case.passes], case.policy)
    state = _fold(case, parts)
    folds = frozenset((step.contributor, step.time) for step in state.steps)
    fades = fades_at(state, case.policy, case.side, case.policy.leave) if state.standing else None
    last = moment(state.last_informative)
    # decayed from the time that is told: how much is left would tell the other one
    shown = state if last is None else replace(state, last_informative=times.round(last).timestamp())
    return {
        "as_of": timestamp(as_of),
        "speaks_for": case.side.value,
        "stands": state.standing and (fades is None or now < fades),
        "stood_since": times.text(moment(state.stood_since)),
        "fades_at": times.text(moment(fades)),
        "contributors_for": state.contributors_for,
        "contributors_against": state.contributors_against,
        "evidence_now": evidence(*decayed(shown, now, case.policy)),
        "prior_weight": case.prior_weight,
        "contributions": [_contribution(case, part, salt, folds, times) for part in parts],
        "course": [
            {
                "time": times.text(moment(step.time)),
                "vehicle": pseudonym(salt, step.contributor),
                "standing": step.standing,
                **evidence(step.weight_for, step.weight_against),
            }
            for step in state.steps
        ],
        "policy": case.policy.to_document(),
        "trust_version": None if case.policy.trusts is None else case.policy.trusts.version,
        "would_flip": would_flip(case, parts),
    }


def would_flip(case: Case, parts: Sequence[Contribution]) -> dict[str, Any]:
    """Return how many further full misses or detections, each by another vehicle, would turn what stands.

    The fold itself is asked, one more at a time: thresholds, the window, forgetting and the contributors it takes are
    those of the policy.
    """
    standing = _fold(case, parts).standing
    by_misses = standing == (case.side is Side.NEW)
    kind = "misses" if by_misses else "detections"
    count = _count_to_flip(case, parts, standing, by_misses=by_misses)
    becomes = "withdrawn" if standing else "confirmed"
    if count is None:
        sentence = f"no number of further {kind} alone"
    else:
        noun = kind if count != 1 else {"misses": "miss", "detections": "detection"}[kind]
        sentence = f"{count} more {noun} by {'different vehicles' if count != 1 else 'another vehicle'}"
    return {"becomes": becomes, "by": kind, "vehicles": count, "sentence": sentence}


def _count_to_flip(case: Case, parts: Sequence[Contribution], standing: bool, *, by_misses: bool) -> int | None:
    last = max((part.time for part in parts), default=0.0)
    extended = list(parts)
    for count in range(1, 2 * case.policy.window + 1):
        # Each an epoch later and by a vehicle that nobody knows.
        one = PassEvidence(
            -count,
            last + count * EPOCH_S,
            0.0 if by_misses else _FULL_WEIGHT,
            _FULL_WEIGHT if by_misses else 0.0,
        )
        extended += contributions([one], case.policy)
        if _fold(case, extended).standing != standing:
            return count
    return None


def _fold(case: Case, parts: Iterable[Contribution]) -> FoldedState:
    return fold(parts, prior_weight=case.prior_weight, policy=case.policy, side=case.side)


def _contribution(
    case: Case, part: Contribution, salt: bytes, folds: frozenset[tuple[int, float]], times: TimesTold
) -> dict[str, Any]:
    mine = [
        item
        for item in case.passes
        if item.contributor == part.contributor and item.ended_at.timestamp() // EPOCH_S == part.epoch
    ]
    return {
        "vehicle": pseudonym(salt, part.contributor),
        "time": times.text(moment(part.time)),
        "weight_for": part.weight_for,
        "weight_against": part.weight_against,
        "informativeness": part.informativeness,
        "passes": part.passes,
        "in_doubt": part.doubtful,
        "folds": (part.contributor, part.time) in folds,
        **_residual(case, mine),
    }


def _residual(case: Case, passes: Iterable[StoredPass]) -> dict[str, Any]:
    """Return how far east and north of the change's place a contributor saw it, and how far that is for its precision.

    The Mahalanobis distance is under the covariance of both places, and not squared: 95 % are below 2.45.
    """
    seen = witnesses(item for item in passes if item.place is not None)
    if not seen:
        return {"position_residual_m": None, "position_mahalanobis": None}
    place = fuse_place(seen, case.policy)
    frame = frame_at(case.lon, case.lat)
    shift = frame.to_local(place.lon, place.lat) - frame.to_local(case.lon, case.lat)
    (spread,) = covariances([place.covariance_m2]) + covariances([case.covariance_m2])
    distance = float(np.sqrt(shift @ np.linalg.solve(spread, shift)))
    return {"position_residual_m": shift.tolist(), "position_mahalanobis": distance}
