"""Merging finds of one class bottom up, the likeliest pair first, under the constraints that a camera gives.

Many connected groups at once: each merges its own likeliest pair in every step, as long as it has one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.finds import Batch, Codes, Flags, Group, batches, joint, named, sums_over
from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.geometry import inverse, mahalanobis_square, times

Array = NDArray[np.float64]

_PAIRS_AT_ONCE = 1 << 16  # of costs: each has a covariance
_SWEEPS = 8  # of moving single finds; two or three settle nearly every group


@dataclass(frozen=True, slots=True)
class Part:
    """One cluster: its members (indices into the finds, ascending), its place, and what they say it is."""

    members: tuple[int, ...]
    xy: Array  # (2,), m
    covariance: Array  # (2, 2), m², for telling whether another pass is about it; not that of the place
    sign: str | None
    value: str | None


def agglomerate(groups: Sequence[Group], policy: ClassPolicy) -> list[list[Part]]:
    """Partition the finds of each of many connected groups of one class.

    The pair of clusters with the smallest d² + ln det S merges next as long as its Mahalanobis distance d² passes the
    gate; ln det S lets precise pairs go first, so that a vague find joins a cluster that stands instead of bridging
    two. Then single finds move to where they fit better, which frees those that an early merge of two neighbours
    locked in (`_moved`), and what has become mergeable merges. Costs O(N²) memory for a group of N.

    Returns
    -------
    Clusters of each group, in order of their first members.
    """
    made: dict[int, list[Part]] = {}
    for numbers in batches(groups):
        batch = Batch.of([groups[number] for number in numbers], policy)
        made.update(zip(numbers, _parts(_partition(batch), batch), strict=True))
    return [made[number] if number in made else [_alone(group)] for number, group in enumerate(groups)]


def _alone(group: Group) -> Part:
    """Return the one find of a group, as many have, as a cluster."""
    return Part((0,), group.xy[0], group.covariance[0], group.finds[0].sign, group.finds[0].value)


def pair_costs(difference: Array, covariance: Array, policy: ClassPolicy) -> Array:
    """Return d² + ln det S of differences (2, ...) with S (3, ...); infinite outside the gate or match radius."""
    x, y = difference
    squared, determinant = mahalanobis_square(difference, covariance)
    inside = (squared <= policy.gate) & (x * x + y * y <= policy.match_radius_m**2)
    return np.asarray(np.where(inside, squared + np.log(determinant), np.inf))


def compatible(one: str | None, other: str | None) -> bool:
    """Whether two signs or values can be of one object: None goes with anything."""
    return one is None or other is None or one == other


def _partition(batch: Batch) -> Codes:
    """Return the cluster of each find, (G, N): the index of its first member; -1 for padding."""
    label = np.where(batch.present, np.arange(batch.present.shape[1]), -1)
    active = np.arange(len(label))
    for _ in range(_SWEEPS):
        merged = _Merging(label[active], active, batch).run()
        moved = label[active] = _moved(merged, active, batch)
        active = active[(moved != merged).any(axis=1)]
        if not len(active):
            break
    return label


def _parts(label: Codes, batch: Batch) -> list[list[Part]]:
    slots = label.shape[1]
    vector, information, count = _sums(label, np.arange(len(label)), batch, slots)
    places, spreads = _summary(information, vector, count)
    names = named(label, batch.names, slots)
    made = []
    for group, labels in enumerate(label.tolist()):
        members: dict[int, list[int]] = {}
        for find, slot in enumerate(labels):
            if slot >= 0:
                members.setdefault(slot, []).append(find)
        parts = []
        for slot, mine in members.items():
            sxx, sxy, syy = spreads[:, group, slot]
            sign, value = (batch.texts[code] for code in names[:, group, slot].tolist())
            parts.append(Part(tuple(mine), places[:, group, slot], np.array([[sxx, sxy], [sxy, syy]]), sign, value))
        made.append(parts)
    return made


def _sums(label: Codes, groups: Codes, batch: Batch, slots: int) -> tuple[Array, Array, Array]:
    """Return the summed vectors (2, G, S) and information (3, G, S) of clusters, and how many finds each has (G, S)."""
    values = np.concatenate([batch.vector[:, groups], batch.information[:, groups], batch.present[None, groups]])
    made = sums_over(label, values, slots)
    return made[:2], made[2:5], made[5]


def _summary(information: Array, vector: Array, count: Array) -> tuple[Array, Array]:
    """Return the places (2, ...) of clusters with summed information and their covariances (3, ...) for association.

    That covariance is the mean of the place's own and of a typical member's. The place's own alone would shrink with
    every member until two halves of one cloud, chosen because they are near each other, no longer looked alike. Where
    there is no cluster any place will do.
    """
    none = count <= 0.0
    own = inverse(np.where(none, np.array([1.0, 0.0, 1.0]).reshape(3, *(1 for _ in count.shape)), information))
    return times(own, vector), 0.5 * (1.0 + count) * own


def _agree(one: Codes, other: Codes) -> Flags:
    """Whether names (2, ...) can be of one object."""
    return np.asarray(((one == 0) | (other == 0) | (one == other)).all(axis=0))


class _Merging:
    """The clusters of A groups while they merge: a slot for each, of which the lower one survives a merge."""

    def __init__(self, label: Codes, groups: Codes, batch: Batch) -> None:
        self._policy, self._label = batch.policy, label.copy()
        rows, slots = label.shape
        self._alive = label == np.arange(slots)
        self._vector, self._information, self._count = _sums(label, groups, batch, slots)
        self._names = named(label, batch.names[:, groups], slots)
        self._apart = batch.together[groups]
        if self._apart.any():
            belongs = (label[:, None] == np.arange(slots)[:, None]).astype(float)
            self._apart = belongs @ self._apart.astype(float) @ belongs.transpose(0, 2, 1) > 0.0
        self._places, self._spreads = _summary(self._information, self._vector, self._count)
        step = max(1, _PAIRS_AT_ONCE // (rows * slots))
        pieces = [np.arange(slots)[at : at + step] for at in range(0, slots, step)]
        self._costs = np.concatenate([self._rows(np.arange(rows), each) for each in pieces], axis=1)
        self._nearest = self._costs.argmin(axis=2)

    def run(self) -> Codes:
        """Merge until no group has a pair left, and return the cluster of each find."""
        rows = np.arange(len(self._label))
        while True:
            best = np.take_along_axis(self._costs, self._nearest[:, :, None], axis=2)[:, :, 0]
            slot = best.argmin(axis=1)
            going = np.isfinite(best[rows, slot])
            if not going.any():
                return self._label
            at, one = rows[going], slot[going]
            other = self._nearest[at, one]
            self._merge(at, np.minimum(one, other), np.maximum(one, other))

    def _merge(self, at: Codes, slot: Codes, gone: Codes) -> None:
        """Merge one slot of each of some groups into another one of it."""
        for sums in (self._vector, self._information, self._count[None]):
            sums[:, at, slot] += sums[:, at, gone]
        self._places[:, at, slot], self._spreads[:, at, slot] = _summary(
            self._information[:, at, slot], self._vector[:, at, slot], self._count[at, slot]
        )
        self._names[:, at, slot] = joint(self._names[:, at, slot], self._names[:, at, gone])
        self._apart[at, slot] |= self._apart[at, gone]
        self._apart[at, :, slot] |= self._apart[at, :, gone]
        self._alive[at, gone] = False
        labels = self._label[at]
        self._label[at] = np.where(labels == gone[:, None], slot[:, None], labels)
        self._costs[at, gone] = self._costs[at, :, gone] = np.inf
        costs = self._rows(at, slot[:, None])[:, 0]
        self._costs[at, slot] = self._costs[at, :, slot] = costs

        # only rows whose nearest has changed need a new search
        nearest = self._nearest[at]
        stale = (nearest == slot[:, None]) | (nearest == gone[:, None])
        stale[np.arange(len(at)), slot] = True
        group, row = np.nonzero(stale)
        nearest[group, row] = self._costs[at[group], row].argmin(axis=1)
        best = self._costs[at[:, None], np.arange(nearest.shape[1]), nearest]
        closer = (costs < best) | ((costs == best) & (slot[:, None] < nearest))
        self._nearest[at] = np.where(closer, slot[:, None], nearest)

    def _rows(self, at: Codes, slots: Codes) -> Array:
        """Return what merging slots (R,), or (A, R), with each other one costs, (A, R, C); infinite where forbidden."""
        chosen = np.broadcast_to(slots, (len(at), slots.shape[-1]))
        of = at[:, None], chosen
        difference = self._places[:, at, None] - self._places[:, *of, None]
        costs = pair_costs(difference, self._spreads[:, at, None] + self._spreads[:, *of, None], self._policy)
        barred = ~self._alive[at, None] | ~self._alive[*of, None] | self._apart[of]
        barred |= chosen[:, :, None] == np.arange(self._label.shape[1])
        barred |= ~_agree(self._names[:, at, None], self._names[:, *of, None])
        costs[barred] = np.inf
        return costs


def _moved(label: Codes, groups: Codes, batch: Batch) -> Codes:
    """Move every find to the cluster that it fits best, all at once, and return the cluster of each.

    Clusters are judged without the find itself, and as a mixture: one with n members is n times as likely. Within a
    session the best fit chooses first, and finds seen together never choose the same. A find that fits nowhere stays
    alone.
    """
    alive = label == np.arange(label.shape[1])
    rank = np.cumsum(alive, axis=1) - 1
    clusters = int(alive.sum(axis=1).max())
    present = batch.present[groups]
    number = np.where(present, np.take_along_axis(rank, np.maximum(label, 0), axis=1), -1)  # (A, N)
    vector, information, count = _sums(number, groups, batch, clusters)
    mine = number[:, :, None] == np.arange(clusters)  # (A, N, C)
    others = count[:, None] - mine
    places, spreads = _summary(
        information[:, :, None] - mine * batch.information[:, groups, :, None],
        vector[:, :, None] - mine * batch.vector[:, groups, :, None],
        others,
    )
    difference = places - batch.xy[:, groups, :, None]
    costs = pair_costs(difference, spreads + batch.covariance[:, groups, :, None], batch.policy)
    fits = np.isfinite(costs) & (others > 0.0) & present[:, :, None]
    costs = np.where(fits, costs - 2.0 * np.log(np.maximum(others, 1.0)), np.inf)
    moved = label.copy()
    # where all fit the only cluster there is, nothing moves
    for at in np.flatnonzero((rank[:, -1] > 0) | (present & ~fits[:, :, 0]).any(axis=1)).tolist():
        group = groups[at]
        moved[at] = _chosen(costs[at], number[at], batch.names[:, group], batch.together[group])
    return moved


def _chosen(costs: Array, number: Codes, names: Codes, together: Flags) -> Codes:
    """Let the finds of one group choose by their costs (N, C), the best fit first, and return the cluster of each."""
    said = named(number[None], names[:, None], costs.shape[1])[:, 0].T.tolist()
    chosen: list[list[int]] = [[] for _ in said]
    waiting = number >= 0
    rows, columns = np.nonzero(np.isfinite(costs))
    for pair in np.lexsort((columns, rows, costs[rows, columns])).tolist():
        find, cluster = int(rows[pair]), int(columns[pair])
        if not waiting[find] or together[find, chosen[cluster]].any():
            continue
        name = names[:, find].tolist()
        if all(not one or not other or one == other for one, other in zip(name, said[cluster], strict=True)):
            said[cluster] = [one or other for one, other in zip(said[cluster], name, strict=True)]
            chosen[cluster].append(find)
            waiting[find] = False
    label = np.where(waiting, np.arange(len(number)), -1)
    for each in chosen:
        label[each] = min(each, default=-1)
    return label
