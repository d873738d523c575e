"""Which finds are the same object: joint clustering of passes that no map feature explains.

Finds are merged bottom up, the likeliest pair of clusters first, over the whole connected group at once. Precise pairs
go first, so two signs 2 m apart become two tight clusters before anything could bridge them. Ties go to the canonical
order of the passes, so the partition is a pure function of the set of passes.
"""

from __future__ import annotations

from collections.abc import Generator, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.aggregation.agglomeration import Part, agglomerate, compatible, pair_costs
from slamcu_core.aggregation.finds import Find, Group
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


@dataclass(frozen=True, slots=True)
class Passes:
    """N passes that are to be partitioned together: a connected group, or several of one frame."""

    xy: ArrayLike  # (N, 2) m, in a local frame that must not depend on the set of passes
    covariance: ArrayLike  # (N, 2, 2) m²
    evidence_sign: ArrayLike  # (N,), +1 for a find, -1 for an own find that was looked for and missed
    group_key: Sequence[str]  # class of each pass
    sign: Sequence[str | None]  # as seen, or None
    value: Sequence[str | None]
    observer: Sequence[tuple[Hashable, ...]]  # (contributor, session)
    interval: ArrayLike  # (N, 2), start and end of the time in view, s
    order_key: Sequence[tuple[Any, ...]]  # identity; unique, and comparable with each other
    doubtful: Sequence[bool] | None = None  # whether the filter said that it is not to be trusted; None: nobody's did


def cluster(groups: Sequence[Passes], policy: Policy) -> list[Clusters]:
    """Partition each of many groups of passes into candidates, numbered by their founders in canonical order.

    Two finds of one observer whose times in view overlap are two objects and never share a cluster. Classes never mix;
    signs and values that differ never mix, None goes with anything. A miss goes to the nearest cluster within the gate.
    What was said in doubt does not change what the others are: such a find goes to the nearest cluster too, and where
    there is none makes clusters with its like.

    Groups know nothing of each other: each is partitioned as it would be alone, to the last bit.

    Raises EvidenceError on wrong shapes, places or covariances that are not usable, or identities that repeat.
    """
    steps = [_partition(group, policy) for group in groups]
    made: dict[int, Clusters] = {}
    answers: dict[int, list[list[Part]] | None] = dict.fromkeys(range(len(groups)))
    while answers:
        asked: dict[int, list[_Finds]] = {}
        for number, answer in answers.items():
            try:
                asked[number] = steps[number].send(answer) if answer is not None else next(steps[number])
            except StopIteration as finished:
                made[number] = finished.value
        answers = dict(_merged_together(asked, policy))
    return [made[number] for number in range(len(groups))]


_Finds = tuple[str, Group]  # of one connected group, and their class


@dataclass(frozen=True, slots=True)
class _Laid:
    """A group's passes as one class of them sees them."""

    passes: Passes
    name: str
    places: Array  # (N, 2), m
    covariances: Array  # (N, 2, 2), with the class's floor, m²
    times: Array  # (N, 2), s
    policy: ClassPolicy


def _merged_together(asked: Mapping[int, Sequence[_Finds]], policy: Policy) -> Iterator[tuple[int, list[list[Part]]]]:
    """Yield the clusters of what each asks for; all finds of one class merge side by side."""
    merged: dict[str, Iterator[list[Part]]] = {}
    for name in sorted({name for finds in asked.values() for name, _ in finds}):
        groups = [group for finds in asked.values() for each, group in finds if each == name]
        merged[name] = iter(agglomerate(groups, policy.for_class(name)))
    for number, finds in asked.items():
        yield number, [next(merged[name]) for name, _ in finds]


def _partition(passes: Passes, policy: Policy) -> Generator[list[_Finds], list[list[Part]], Clusters]:
    """Partition one group: yield finds that are to be merged, each with its class, and go on with their clusters."""
    order = _canonical_order(passes.order_key)
    places = np.asarray(passes.xy, float).reshape(-1, 2)
    covariances = np.asarray(passes.covariance, float).reshape(-1, 2, 2)
    found = np.asarray(passes.evidence_sign) > 0
    times = np.asarray(passes.interval, float).reshape(-1, 2)
    doubted = np.zeros(len(order), bool) if passes.doubtful is None else np.asarray(passes.doubtful, bool)
    lengths = {len(places), len(covariances), len(found), len(times), len(order), len(doubted)}
    columns = passes.group_key, passes.sign, passes.value, passes.observer
    if len(lengths | {len(names) for names in columns}) != 1:
        raise EvidenceError("every argument of a clustering needs one entry for each pass")
    check_positions(places, covariances)

    labels = np.full(len(order), -1, np.intp)
    parts: list[Part] = []
    for name in sorted(set(passes.group_key)):
        rules = policy.for_class(name)
        chosen = [i for i in order if passes.group_key[i] == name]
        floored = own_covariance(covariances, rules) + rules.position_floor_m**2 * np.eye(2)
        laid = _Laid(passes, name, places, floored, times, rules)
        finds = np.array([i for i in chosen if found[i] and not doubted[i]], np.intp)
        mine = yield from _merged(laid, finds)
        belongs = {i: _nearest(laid, i, mine) for i in chosen if doubted[i] or not found[i]}
        rest = np.array([i for i, number in belongs.items() if number is None and found[i]], np.intp)
        known = len(mine)
        mine += yield from _merged(laid, rest)
        for one in [i for i, number in belongs.items() if number is None and not found[i]]:
            beside = _nearest(laid, one, mine[known:])
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


def _merged(laid: _Laid, finds: NDArray[np.intp]) -> Generator[list[_Finds], list[list[Part]], list[Part]]:
    """Cluster the finds of one class, given in canonical order; members are indices of the passes."""
    if not len(finds):
        return []
    sessions: dict[Hashable, int] = {}
    cards = [
        Find(
            sessions.setdefault(laid.passes.observer[i], len(sessions)),
            start,
            end,
            laid.passes.sign[i],
            laid.passes.value[i],
        )
        for i, (start, end) in zip(finds.tolist(), laid.times[finds].tolist(), strict=True)
    ]
    label = connected_groups(laid.places[finds], laid.policy.match_radius_m)
    groups = [np.flatnonzero(label == group) for group in range(int(label.max()) + 1)]
    merged = yield [
        (
            laid.name,
            Group(laid.places[finds[chosen]], laid.covariances[finds[chosen]], [cards[i] for i in chosen.tolist()]),
        )
        for chosen in groups
    ]
    return [
        replace(part, members=tuple(finds[chosen[list(part.members)]].tolist()))
        for chosen, parts in zip(groups, merged, strict=True)
        for part in parts
    ]


def _nearest(laid: _Laid, one: int, parts: Sequence[Part]) -> int | None:
    """Return which cluster a pass is about: the likeliest within the gate that has a find within the match radius."""
    best, nearest = np.inf, None
    for number, part in enumerate(parts):
        if not (compatible(laid.passes.sign[one], part.sign) and compatible(laid.passes.value[one], part.value)):
            continue
        spread = (part.covariance + laid.covariances[one]).reshape(4)[[0, 1, 3]]
        cost = float(pair_costs(part.xy - laid.places[one], spread, laid.policy))
        distances = np.hypot(*(laid.places[list(part.members)] - laid.places[one]).T)
        if cost < best and distances.min() <= laid.policy.match_radius_m:
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
