"""Which finds are the same object: joint clustering of passes that no map feature explains.

Finds are merged bottom up, the likeliest pair of clusters first, over the whole connected group at once. Precise pairs
go first, so two signs 2 m apart become two tight clusters before anything could bridge them. Ties go to the canonical
order of the passes, so the partition is a pure function of the set of passes.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.aggregation.agglomeration import Find, Part, agglomerate, compatible, pair_costs
from slamcu_core.aggregation.groups import connected_groups
from slamcu_core.aggregation.policy import ClassPolicy, Policy
from slamcu_core.aggregation.position import check_positions, own_covariance
from slamcu_core.errors import EvidenceError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Clusters:
    """A partition of passes into candidates."""

    labels: NDArray[np.intp]  # (N,), the cluster of each pass, -1 for a miss that is near no cluster
    founders: NDArray[np.intp]  # (C,), index of the first find of each cluster in canonical order


def cluster(
    xy: ArrayLike,
    covariance: ArrayLike,
    evidence_sign: ArrayLike,
    *,
    group_key: Sequence[str],
    sign: Sequence[str | None],
    value: Sequence[str | None],
    observer: Sequence[tuple[Hashable, ...]],
    interval: ArrayLike,
    order_key: Sequence[tuple[Any, ...]],
    policy: Policy,
    doubtful: Sequence[bool] | None = None,
) -> Clusters:
    """Partition N passes into candidates; clusters are numbered by their founders in canonical order.

    Two finds of one observer whose times in view overlap are two objects and never share a cluster. Classes never mix;
    signs and values that differ never mix, None goes with anything. A miss goes to the nearest cluster within the gate.
    What was said in doubt does not change what the others are: such a find goes to the nearest cluster too, and where
    there is none makes clusters with its like.

    Parameters
    ----------
    xy : (N, 2) m, in a local frame that must not depend on the set of passes.
    covariance : (N, 2, 2) m².
    evidence_sign : (N,), +1 for a find, -1 for an own find that was looked for and missed.
    group_key : class of each pass.
    sign, value : as seen, or None.
    observer : (contributor, session) of each pass.
    interval : (N, 2), start and end of the time in view, s.
    order_key : identity of each pass; unique, and comparable with each other.
    doubtful : of each pass, whether the filter said that it is not to be trusted; None: nobody's did.

    Raises EvidenceError on wrong shapes, places or covariances that are not usable, or identities that repeat.
    """
    order = _canonical_order(order_key)
    places, covariances = np.asarray(xy, float).reshape(-1, 2), np.asarray(covariance, float).reshape(-1, 2, 2)
    found, times = np.asarray(evidence_sign) > 0, np.asarray(interval, float).reshape(-1, 2)
    doubted = np.zeros(len(order), bool) if doubtful is None else np.asarray(doubtful, bool)
    lengths = {len(places), len(covariances), len(found), len(times), len(order), len(doubted)}
    if len(lengths | {len(names) for names in (group_key, sign, value, observer)}) != 1:
        raise EvidenceError("every argument of a clustering needs one entry for each pass")
    check_positions(places, covariances)

    labels = np.full(len(order), -1, np.intp)
    parts: list[Part] = []
    for name in sorted(set(group_key)):
        rules = policy.for_class(name)
        chosen = [i for i in order if group_key[i] == name]
        floored = own_covariance(covariances, rules) + rules.position_floor_m**2 * np.eye(2)
        finds = np.array([i for i in chosen if found[i] and not doubted[i]], np.intp)
        mine = _merged(places, floored, finds, sign=sign, value=value, observer=observer, times=times, policy=rules)
        belongs = {
            i: _nearest(places, floored, i, mine, sign=sign, value=value, policy=rules)
            for i in chosen
            if doubted[i] or not found[i]
        }
        rest = np.array([i for i, number in belongs.items() if number is None and found[i]], np.intp)
        known = len(mine)
        mine += _merged(places, floored, rest, sign=sign, value=value, observer=observer, times=times, policy=rules)
        for one in [i for i, number in belongs.items() if number is None and not found[i]]:
            beside = _nearest(places, floored, one, mine[known:], sign=sign, value=value, policy=rules)
            belongs[one] = None if beside is None else known + beside
        for one, number in belongs.items():
            labels[one] = -1 if number is None else len(parts) + number
        for number, part in enumerate(mine, start=len(parts)):
            labels[list(part.members)] = number
        parts += mine
    return _numbered(labels, [part.members[0] for part in parts], order)


def _canonical_order(order_key: Sequence[tuple[Any, ...]]) -> list[int]:
    order = sorted(range(len(order_key)), key=lambda i: order_key[i])
    for one, other in pairwise(order):
        if order_key[one] == order_key[other]:
            raise EvidenceError(f"two passes have the identity {order_key[one]}: duplicates must be removed first")
    return order


def _merged(
    places: Array,
    covariances: Array,
    finds: NDArray[np.intp],
    *,
    sign: Sequence[str | None],
    value: Sequence[str | None],
    observer: Sequence[tuple[Hashable, ...]],
    times: Array,
    policy: ClassPolicy,
) -> list[Part]:
    """Cluster the finds of one class, given in canonical order; members are indices of passes."""
    sessions: dict[Hashable, int] = {}
    cards = [
        Find(
            session=sessions.setdefault(observer[i], len(sessions)),
            start=float(times[i, 0]),
            end=float(times[i, 1]),
            sign=sign[i],
            value=value[i],
        )
        for i in finds.tolist()
    ]
    groups = connected_groups(places[finds], policy.match_radius_m)
    parts: list[Part] = []
    for group in range(groups.max(initial=-1) + 1):
        chosen = np.flatnonzero(groups == group)
        indices = finds[chosen]
        merged = agglomerate(places[indices], covariances[indices], [cards[i] for i in chosen.tolist()], policy)
        parts += [replace(part, members=tuple(indices[list(part.members)].tolist())) for part in merged]
    return parts


def _nearest(
    places: Array,
    covariances: Array,
    one: int,
    parts: Sequence[Part],
    *,
    sign: Sequence[str | None],
    value: Sequence[str | None],
    policy: ClassPolicy,
) -> int | None:
    """Return which cluster a pass is about: the likeliest within the gate that has a find within the match radius."""
    best, nearest = np.inf, None
    for number, part in enumerate(parts):
        if not (compatible(sign[one], part.sign) and compatible(value[one], part.value)):
            continue
        cost = float(pair_costs(part.xy - places[one], part.covariance + covariances[one], policy))
        distances = np.hypot(*(places[list(part.members)] - places[one]).T)
        if cost < best and distances.min() <= policy.match_radius_m:
            best, nearest = cost, number
    return nearest


def _numbered(labels: NDArray[np.intp], founders: Sequence[int], order: Sequence[int]) -> Clusters:
    """Give the clusters their numbers by the canonical order of their founders."""
    rank = {index: place for place, index in enumerate(order)}
    by_founder = sorted(range(len(founders)), key=lambda number: rank[founders[number]])
    renumber = np.empty(len(founders) + 1, np.intp)
    renumber[by_founder] = np.arange(len(founders))
    renumber[-1] = -1
    return Clusters(renumber[labels], np.array([founders[number] for number in by_founder], np.intp))
