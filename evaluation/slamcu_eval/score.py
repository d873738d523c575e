"""Scoring: what was claimed of a map against what is true.

Every true feature counts once. One that the map has is looked up by its object id; a new one is found if a claim of a
new feature stands within the radius of it, one to one over all of them. Claims of new features that stand for nothing
are `false_new`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from slamcu_core.errors import SlamcuError
from slamcu_core.geometry import mahalanobis_square as squared
from slamcu_eval.statistics import summarize

Array = NDArray[np.float64]

HIGHWAY_RADIUS_M = 3.0  # a claim within this stands for the sign (evaluation contract)
ROBOT_RADIUS_M = 0.5

ALWAYS = ("normal", "deleted", "new")
BEYOND = ("moved", "modified")
UNCLASSIFIED = "unclassified"
_CHI2_95 = 5.991464547107979  # two degrees of freedom

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Fact:
    """A feature as it truly is: where the world has it, or where the map has it if it is deleted."""

    kind: str  # normal, deleted, new, moved or modified
    place: Place  # m
    object_id: int | None = None
    sign: str | None = None
    value: str | None = None
    in_view: bool | None = None  # whether it ever was in a sensor's view; None: not known


@dataclass(frozen=True, slots=True)
class Claim:
    """What a car or the cloud says of a feature."""

    state: str  # as the kinds, or unclassified
    place: Place  # m
    covariance: tuple[float, float, float] | None = None  # xx, xy, yy, m²
    object_id: int | None = None
    sign: str | None = None
    value: str | None = None
    passes: int | None = None


@dataclass(frozen=True, slots=True)
class Match:
    """A claim of a new feature, and the true one that it stands for: a new one, or a moved one at its new place."""

    fact: int
    claim: int
    error_m: float
    inside: bool | None  # of its own 95 % ellipse; None without a covariance


@dataclass(frozen=True, slots=True)
class Score:
    """The outcome of one drive, or of one fused map."""

    said: tuple[tuple[str, str], ...]  # for each fact what it is and what was said of it
    matches: tuple[Match, ...]
    false_new: tuple[int, ...]  # indices of claims
    never_in_view: int

    @property
    def right(self) -> int:
        """How many facts were told as they are."""
        return sum(truth == said for truth, said in self.said)


def score(facts: Sequence[Fact], claims: Sequence[Claim], *, radius_m: float = HIGHWAY_RADIUS_M) -> Score:
    """Compare claims with facts; places of both in one metric frame.

    Raises SlamcuError if two facts or two claims have the same object id.
    """
    by_id = _by_object_id((claim.object_id for claim in claims), "claims")
    _by_object_id((fact.object_id for fact in facts), "facts")
    matches = _match(facts, claims, radius_m)
    found = {match.fact for match in matches}
    said = []
    for index, fact in enumerate(facts):
        claim = claims[by_id[fact.object_id]] if fact.object_id in by_id else None
        said.append((fact.kind, _said(fact, claim, found=index in found, radius_m=radius_m)))
    stands_for = {match.claim for match in matches}
    false_new = tuple(i for i, claim in enumerate(claims) if claim.state == "new" and i not in stands_for)
    return Score(tuple(said), matches, false_new, sum(_never_in_view(fact, claims, by_id) for fact in facts))


def _said(fact: Fact, claim: Claim | None, *, found: bool, radius_m: float) -> str:
    if fact.kind == "new":
        return "new" if found else UNCLASSIFIED
    if claim is None:
        return UNCLASSIFIED
    if claim.state == "moved" and _distance(fact.place, claim.place) > radius_m:
        return UNCLASSIFIED  # it moved, but not to there
    if claim.state == "modified" and fact.kind == "modified" and (claim.sign, claim.value) != (fact.sign, fact.value):
        return UNCLASSIFIED  # it changed, but not to that
    return claim.state


def _match(facts: Sequence[Fact], claims: Sequence[Claim], radius_m: float) -> tuple[Match, ...]:
    """Assign claims of new features to true new and moved ones: as many as possible, then as near as possible."""
    rows = [i for i, fact in enumerate(facts) if fact.kind in {"new", "moved"}]
    columns = [i for i, claim in enumerate(claims) if claim.state == "new"]
    matches = []
    if rows and columns:
        there = np.array([facts[i].place for i in rows])
        said = np.array([claims[i].place for i in columns])
        distance = np.linalg.norm(there[:, None] - said[None, :], axis=-1)
        # Beyond the radius any assignment costs more than all those within it together.
        cost = np.where(distance <= radius_m, distance, 1e3 * radius_m * (len(rows) + len(columns)))
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if distance[row, column] <= radius_m:
                fact, claim = rows[int(row)], columns[int(column)]
                inside = inside_ellipse(facts[fact].place, claims[claim])
                matches.append(Match(fact, claim, float(distance[row, column]), inside))
    return tuple(matches)


def mahalanobis_square(place: Place, claim: Claim) -> float | None:
    """Return the squared distance of a true place from a claim in the claim's own covariance.

    None if the claim has no covariance; infinite if that is not positive definite.
    """
    if claim.covariance is None:
        return None
    xx, xy, yy = claim.covariance
    if xx * yy - xy * xy <= 0.0:
        return float("inf")
    square, _ = squared(np.array(place) - np.array(claim.place), np.array(claim.covariance))
    return float(square)


def inside_ellipse(place: Place, claim: Claim) -> bool | None:
    """Tell whether a true place lies in the 95 % ellipse of a claim; None if the claim has no covariance."""
    square = mahalanobis_square(place, claim)
    return None if square is None else square <= _CHI2_95


def _never_in_view(fact: Fact, claims: Sequence[Claim], by_id: dict[int | None, int]) -> bool:
    """Tell from the truth, or else from a claim without passes, that nobody ever could see a feature."""
    if fact.in_view is not None:
        return not fact.in_view
    return fact.object_id in by_id and claims[by_id[fact.object_id]].passes == 0


def _by_object_id(object_ids: Iterable[int | None], what: str) -> dict[int | None, int]:
    result: dict[int | None, int] = {}
    for index, object_id in enumerate(object_ids):
        if object_id is not None and result.setdefault(object_id, index) != index:
            raise SlamcuError(f"two {what} have the map object id {object_id}")
    return result


def _distance(a: Place, b: Place) -> float:
    return float(np.hypot(a[0] - b[0], a[1] - b[1]))


def confusion(scores: Sequence[Score]) -> dict[str, dict[str, int]]:
    """Return counts by truth (rows) and claim (columns) over scores; moved and modified only where they occur."""
    pairs = [pair for one in scores for pair in one.said]
    present = {name for pair in pairs for name in pair}
    kinds = [*ALWAYS, *(kind for kind in BEYOND if kind in present)]
    table = {truth: dict.fromkeys([*kinds, UNCLASSIFIED], 0) for truth in kinds}
    for truth, said in pairs:
        table[truth][said] += 1
    return table


def figures(scores: Sequence[Score]) -> dict[str, Any]:
    """Return the figures over scores, by the names of the evaluation contract."""
    total = sum(len(one.said) for one in scores)
    matches = [match for one in scores for match in one.matches if one.said[match.fact][0] == "new"]
    covered = [match.inside for match in matches if match.inside is not None]
    return {
        "features": total,
        "confusion": confusion(scores),
        "accuracy": sum(one.right for one in scores) / total if total else float("nan"),
        "false_new": sum(len(one.false_new) for one in scores),
        "never_in_view": sum(one.never_in_view for one in scores),
        "new_position_error_m": summarize([match.error_m for match in matches]),
        "ellipse95_coverage": float(np.mean(covered)) if covered else float("nan"),
    }
