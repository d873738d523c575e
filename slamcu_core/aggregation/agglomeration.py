"""Merging finds of one class bottom up, the likeliest pair first, under the constraints that a camera gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.policy import ClassPolicy

Array = NDArray[np.float64]
Names = tuple[str | None, str | None]  # sign and value, None where nobody could tell

_SAME_PLACE_M = 1e-3
_ROWS_AT_ONCE = 64  # of costs: each has a covariance for every other cluster
_SWEEPS = 8  # of moving single finds; two or three settle nearly every group


@dataclass(frozen=True, slots=True)
class Find:
    """What one pass found, as far as identity goes."""

    session: int  # a code: equal for passes of one session
    start: float  # s
    end: float  # s
    sign: str | None
    value: str | None


@dataclass(frozen=True, slots=True)
class Part:
    """One cluster: its members (indices into the finds, ascending), its place, and what they say it is."""

    members: tuple[int, ...]
    xy: Array  # (2,), m
    covariance: Array  # (2, 2), m², for telling whether another pass is about it; not that of the place
    sign: str | None
    value: str | None


@dataclass(frozen=True, slots=True)
class _Group:
    """The finds of one connected group as arrays."""

    xy: Array  # (N, 2), m
    covariance: Array  # (N, 2, 2), m²
    information: Array  # (N, 2, 2), its inverse
    vector: Array  # (N, 2), information times place
    finds: Sequence[Find]
    together: NDArray[np.bool_]  # (N, N), seen together: different objects
    policy: ClassPolicy


def agglomerate(xy: Array, covariance: Array, finds: Sequence[Find], policy: ClassPolicy) -> list[Part]:
    """Partition the finds of one class and one connected group, given in canonical order.

    The pair of clusters with the smallest d² + ln det S merges next as long as its Mahalanobis distance d² passes the
    gate; ln det S lets precise pairs go first, so that a vague find joins a cluster that stands instead of bridging
    two. Then single finds move to where they fit better, which frees those that an early merge of two neighbours
    locked in (`_moved`), and what has become mergeable merges. Costs O(N²) memory.

    Parameters
    ----------
    xy : (N, 2) m.
    covariance : (N, 2, 2) m².

    Returns
    -------
    Clusters in order of their first members.
    """
    if len(finds) == 1:  # as many are
        return [Part((0,), xy[0], covariance[0], finds[0].sign, finds[0].value)]
    information = np.asarray(np.linalg.inv(covariance), float)
    vector = np.einsum("nij,nj->ni", information, xy)
    group = _Group(xy, covariance, information, vector, finds, _seen_together(xy, finds), policy)
    members = [[index] for index in range(len(finds))]
    for _ in range(_SWEEPS):
        merged = _Merging(members, group).run()
        members = _moved(merged, group)
        if members == merged:
            break
    return [_part(each, group) for each in members]


def pair_costs(difference: Array, covariance: Array, policy: ClassPolicy) -> Array:
    """Return d² + ln det S of differences (..., 2) with S (..., 2, 2); infinite outside the gate or match radius."""
    s = covariance
    determinant = s[..., 0, 0] * s[..., 1, 1] - s[..., 0, 1] * s[..., 1, 0]
    x, y = difference[..., 0], difference[..., 1]
    squared = (s[..., 1, 1] * x * x - 2.0 * s[..., 0, 1] * x * y + s[..., 0, 0] * y * y) / determinant
    inside = (squared <= policy.gate) & (x * x + y * y <= policy.match_radius_m**2)
    return np.asarray(np.where(inside, squared + np.log(determinant), np.inf))


def compatible(one: str | None, other: str | None) -> bool:
    """Whether two signs or values can be of one object: None goes with anything."""
    return one is None or other is None or one == other


def _summary(information: Array, vector: Array, count: Array) -> tuple[Array, Array]:
    """Return the places (..., 2) of clusters with summed information and their covariances for association.

    That covariance is the mean of the place's own and of a typical member's. The place's own alone would shrink with
    every member until two halves of one cloud, chosen because they are near each other, no longer looked alike.
    """
    inverse = np.linalg.inv(information)
    return np.einsum("...ij,...j->...i", inverse, vector), 0.5 * (1.0 + count[..., None, None]) * inverse


def _part(members: Sequence[int], group: _Group) -> Part:
    chosen = list(members)
    information, vector = group.information[chosen].sum(axis=0), group.vector[chosen].sum(axis=0)
    place, spread = _summary(information, vector, np.asarray(len(chosen), float))
    return Part(tuple(chosen), place, spread, *_names(chosen, group.finds))


def _names(members: Sequence[int], finds: Sequence[Find]) -> Names:
    names: Names = (None, None)
    for index in members:
        names = _joint(names, (finds[index].sign, finds[index].value))
    return names


def _joint(one: Names, other: Names) -> Names:
    """Return what compatible names say together: the sign and value that either knows."""
    return one[0] if one[0] is not None else other[0], one[1] if one[1] is not None else other[1]


class _Merging:
    """Clusters while they merge: a slot for each, of which the lower one survives a merge."""

    def __init__(self, members: Sequence[Sequence[int]], group: _Group) -> None:
        self._policy = group.policy
        self._members = [list(each) for each in members]
        self._count = np.array([len(each) for each in members], float)
        self._information = np.array([group.information[each].sum(axis=0) for each in self._members])
        self._vector = np.array([group.vector[each].sum(axis=0) for each in self._members])
        self._names = [_names(each, group.finds) for each in self._members]
        belongs = np.zeros((len(self._members), len(group.finds)))
        for slot, each in enumerate(self._members):
            belongs[slot, each] = 1.0
        self._apart = belongs @ group.together @ belongs.T > 0.0
        self._alive = np.ones(len(members), bool)
        self._places, self._spreads = _summary(self._information, self._vector, self._count)
        pieces = range(0, len(members), _ROWS_AT_ONCE)
        self._costs = np.concatenate([self._rows(np.arange(len(members))[at : at + _ROWS_AT_ONCE]) for at in pieces])
        self._nearest = self._costs.argmin(axis=1)

    def run(self) -> list[list[int]]:
        """Merge until no pair is left, and return the members of each cluster, in order of their first."""
        slots = np.arange(len(self._members))
        while True:
            best = self._costs[slots, self._nearest]
            row = int(np.argmin(best))
            if not np.isfinite(best[row]):
                return [each for each, alive in zip(self._members, self._alive.tolist(), strict=True) if alive]
            self._merge(*sorted((row, int(self._nearest[row]))))

    def _merge(self, slot: int, gone: int) -> None:
        self._members[slot] = sorted(self._members[slot] + self._members[gone])
        for sums in (self._count, self._information, self._vector):
            sums[slot] += sums[gone]
        self._places[slot], self._spreads[slot] = _summary(
            self._information[slot], self._vector[slot], self._count[slot]
        )
        self._names[slot] = _joint(self._names[slot], self._names[gone])
        self._apart[slot] |= self._apart[gone]
        self._apart[:, slot] |= self._apart[:, gone]
        self._alive[gone] = False
        self._costs[gone] = self._costs[:, gone] = np.inf
        self._costs[slot] = self._costs[:, slot] = self._rows(np.array([slot]))[0]

        # only rows whose nearest has changed need a new search
        stale = (self._nearest == slot) | (self._nearest == gone)
        stale[slot] = True
        self._nearest[stale] = self._costs[stale].argmin(axis=1)
        best = self._costs[np.arange(len(self._nearest)), self._nearest]
        closer = self._costs[:, slot] < best
        closer |= (self._costs[:, slot] == best) & (slot < self._nearest)
        self._nearest[closer] = slot

    def _rows(self, slots: NDArray[np.intp]) -> Array:
        """Return what merging R slots with each other one costs, (R, C); infinite where it is not allowed."""
        costs = pair_costs(
            self._places - self._places[slots, None], self._spreads + self._spreads[slots, None], self._policy
        )
        costs[~self._alive | self._apart[slots]] = np.inf
        costs[np.arange(len(slots)), slots] = np.inf
        if len(set(self._names)) > 1:
            for row, other in np.argwhere(np.isfinite(costs)).tolist():
                if not all(map(compatible, self._names[slots[row]], self._names[other])):
                    costs[row, other] = np.inf
        return costs


def _moved(members: Sequence[Sequence[int]], group: _Group) -> list[list[int]]:
    """Move every find to the cluster that it fits best, all at once, and return the members of each cluster.

    Clusters are judged without the find itself, and as a mixture: one with n members is n times as likely. Within a
    session the best fit chooses first, and finds seen together never choose the same. A find that fits nowhere stays
    alone.
    """
    label = np.empty(len(group.finds), np.intp)
    for number, each in enumerate(members):
        label[each] = number
    mine = label[:, None] == np.arange(len(members))
    information = np.einsum("nc,nij->cij", mine, group.information)
    vector = np.einsum("nc,ni->ci", mine, group.vector)
    count = mine.sum(axis=0) - mine.astype(float)
    alone = count == 0
    others = information - mine[..., None, None] * group.information[:, None]
    others[alone] = np.eye(2)  # nothing is left: any invertible matrix will do, the cost is infinite
    places, spreads = _summary(others, vector - mine[..., None] * group.vector[:, None], count)
    costs = pair_costs(places - group.xy[:, None], spreads + group.covariance[:, None], group.policy)
    costs = np.where(alone, np.inf, costs - 2.0 * np.log(np.maximum(count, 1.0)))
    names = [_names(each, group.finds) for each in members]

    chosen: list[list[int]] = [[] for _ in members]
    waiting = np.ones(len(group.finds), bool)
    rows, columns = np.nonzero(np.isfinite(costs))
    for pair in np.lexsort((columns, rows, costs[rows, columns])).tolist():
        find, number = int(rows[pair]), int(columns[pair])
        if not waiting[find] or group.together[find, chosen[number]].any():
            continue
        name = group.finds[find].sign, group.finds[find].value
        if all(map(compatible, name, names[number])):
            names[number] = _joint(names[number], name)
            chosen[number].append(find)
            waiting[find] = False
    lonely = [[find] for find in np.flatnonzero(waiting).tolist()]
    return sorted(sorted(each) for each in (*chosen, *lonely) if each)


def _seen_together(xy: Array, finds: Sequence[Find]) -> NDArray[np.bool_]:
    """Return (N, N), which finds one session had in view at the same time: different objects.

    The same times at the same place are one find told twice; else a message sent again under new ids would be as many
    objects as it has copies.
    """
    session = np.array([find.session for find in finds])
    start, end = np.array([find.start for find in finds]), np.array([find.end for find in finds])
    together = np.asarray(session[:, None] == session, bool)
    together &= (start[:, None] <= end) & (start <= end[:, None])
    told_twice = (start[:, None] == start) & (end[:, None] == end)
    told_twice &= (np.abs(xy[:, None] - xy) <= _SAME_PLACE_M).all(axis=2)
    together &= ~told_twice
    np.fill_diagonal(together, val=False)
    return together
