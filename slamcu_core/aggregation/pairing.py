"""Which deleted map feature and which new one are one thing: it has moved, or it says something else now.

A pure rule over what is believed: what stands first, then what enough contributors have seen, then the nearest under
the combined covariance, one to one, ties in canonical order.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.agglomeration import compatible
from slamcu_core.aggregation.policy import ClassPolicy, Policy

Array = NDArray[np.float64]

_DAY_S = 86400.0


@dataclass(frozen=True, slots=True)
class Half:
    """A map feature that evidence speaks against, or a candidate that it speaks for."""

    key: Hashable  # identity, for the caller
    order: tuple[Any, ...]  # canonical, comparable among halves of one kind; decides between equal distances
    feature_class: str
    sign: str | None
    value: str | None
    covariance: Array  # (2, 2), m²
    begun: tuple[float | None, float | None]  # POSIX s, the change came about between these; None: no bound
    heading_deg: float | None = None  # compass direction that the map says its face looks
    standing: bool = True  # whether enough contributors say so for a change
    contributors: int = 1  # who say so
    weak: bool = False  # of a map feature: too little is said for more than that what is in its place is no second one


@dataclass(frozen=True, slots=True)
class Pairing:
    """A map feature and a candidate that are one change."""

    feature: Hashable
    candidate: Hashable
    modified: bool  # the same place says something else; otherwise the same thing stands elsewhere


def pair(
    features: Sequence[Half],
    candidates: Sequence[Half],
    difference: Callable[[Half, Half], Array | None],
    policy: Policy,
) -> list[Pairing]:
    """Pair deleted features with candidates, one to one: what stands goes first, then what is nearest.

    What one car only has seen may be anything, and a vague place is never far from anything: that goes later. A map
    feature that is weakly denied comes last, and only for what is like it within the match radius.

    At the same place (within the gate and the match radius) they are one `modified` thing if sign or value differ, and
    one that has moved a little if not. Farther away, up to `pair_radius_m`, they are one moved thing if class and sign
    are the same, the values do not differ, it is still on its side of the road, and the one came when the other went,
    within `pair_days`.

    Parameters
    ----------
    difference : (2,) m east and north, from a feature to a candidate; None on different maps, or far apart.

    Returns
    -------
    The pairs in canonical order of their features.
    """
    found: list[tuple[tuple[bool, int, bool], float, tuple[Any, ...], tuple[Any, ...], Pairing]] = []
    for feature in features:
        rules = policy.for_class(feature.feature_class)
        for candidate in candidates:
            if candidate.feature_class != feature.feature_class:
                continue
            shift = difference(feature, candidate)
            if shift is None:
                continue
            squared = _squared_distance(feature, candidate, shift, rules)
            modified = _modified(feature, candidate, squared, shift, rules)
            if modified is not None:
                pairing = Pairing(feature.key, candidate.key, modified)
                open_halves = (not feature.standing) + (not candidate.standing)
                alone = candidate.contributors < rules.contributors_new
                rank = feature.weak, open_halves, alone
                found.append((rank, squared, feature.order, candidate.order, pairing))
    taken: set[tuple[bool, Hashable]] = set()
    pairs: list[tuple[tuple[Any, ...], Pairing]] = []
    for *_, order, _, one in sorted(found, key=lambda item: item[:4]):
        ends = {(True, one.feature), (False, one.candidate)}
        if not taken & ends:
            taken |= ends
            pairs.append((order, one))
    return [one for _, one in sorted(pairs, key=lambda item: item[0])]


def _squared_distance(feature: Half, candidate: Half, shift: Array, rules: ClassPolicy) -> float:
    spread = feature.covariance + candidate.covariance + rules.position_floor_m**2 * np.eye(2)
    return float(shift @ np.linalg.solve(spread, shift))


def _modified(feature: Half, candidate: Half, squared: float, shift: Array, rules: ClassPolicy) -> bool | None:
    """Tell whether two halves are one modified thing (True), a moved one (False), or not one (None)."""
    same = compatible(feature.sign, candidate.sign) and compatible(feature.value, candidate.value)
    distance_m = float(np.hypot(*shift))
    if feature.weak and not (same and distance_m <= rules.match_radius_m):
        return None
    if squared <= rules.gate and distance_m <= rules.match_radius_m:
        return not same
    if distance_m > rules.pair_radius_m or not same or feature.sign != candidate.sign:
        return None
    if _across(shift, feature.heading_deg) > rules.pair_lateral_m:
        return None
    return False if _at_once(feature.begun, candidate.begun, rules.pair_days * _DAY_S) else None


def _across(shift: Array, heading_deg: float | None) -> float:
    """Return how far a shift (2,) east and north goes across a compass direction; 0 if that is not known."""
    if heading_deg is None:
        return 0.0
    heading = np.deg2rad(heading_deg)
    return float(abs(shift[0] * np.cos(heading) - shift[1] * np.sin(heading)))


def _at_once(
    one: tuple[float | None, float | None], other: tuple[float | None, float | None], tolerance_s: float
) -> bool:
    """Whether two events, each known to lie between two times, may lie within a tolerance of each other."""
    return all(
        earliest is None or latest is None or earliest - tolerance_s <= latest
        for earliest, latest in ((one[0], other[1]), (other[0], one[1]))
    )
