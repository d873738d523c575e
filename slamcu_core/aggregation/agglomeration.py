"""Merging finds of one class bottom up, the likeliest pair first, under the constraints that a camera gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.aggregation.position import information_mean, own_covariance, per_contributor

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Find:
    """What one pass found, as far as identity goes."""

    contributor: int  # a code: equal for passes of one contributor
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
    covariance: Array  # (2, 2), m²
    sign: str | None
    value: str | None


def agglomerate(xy: Array, covariance: Array, finds: Sequence[Find], policy: ClassPolicy) -> list[Part]:
    """Partition the finds of one class and one connected group, given in canonical order.

    The pair of clusters with the smallest d² + ln det S merges next, where d² is the Mahalanobis distance of their
    places and S the sum of their covariances, as long as d² passes the gate; ln det S lets precise pairs go first, so
    that a vague find joins a cluster that stands instead of bridging two. Costs O(N²) memory, and time as long as few
    rows lose their nearest neighbour at once.

    Parameters
    ----------
    xy : (N, 2) m.
    covariance : (N, 2, 2) m².

    Returns
    -------
    Clusters in order of their first members.
    """
    state = _State(xy, covariance, finds, policy)
    while True:
        row = int(np.argmin(state.best))
        if not np.isfinite(state.best[row]):
            break
        state.merge(*sorted((row, int(state.nearest[row]))))
    return [state.part(slot) for slot in np.flatnonzero(state.alive).tolist()]


def pair_costs(xy: Array, covariance: Array, places: Array, covariances: Array, policy: ClassPolicy) -> Array:
    """Return d² + ln det S of one place (2,) against others (N, 2); infinite outside the gate or the match radius."""
    difference = places - xy
    s = covariances + covariance
    determinant = s[:, 0, 0] * s[:, 1, 1] - s[:, 0, 1] * s[:, 1, 0]
    x, y = difference.T
    squared = (s[:, 1, 1] * x * x - (s[:, 0, 1] + s[:, 1, 0]) * x * y + s[:, 0, 0] * y * y) / determinant
    inside = (squared <= policy.gate) & (x * x + y * y <= policy.match_radius_m**2)
    return np.where(inside, squared + np.log(determinant), np.inf)


def compatible(one: str | None, other: str | None) -> bool:
    """Whether two signs or values can be of one object: None goes with anything."""
    return one is None or other is None or one == other


class _State:
    """The clusters while they merge: a slot for each find, of which the lower survives a merge."""

    def __init__(self, xy: Array, covariance: Array, finds: Sequence[Find], policy: ClassPolicy) -> None:
        self._policy = policy
        self._common = policy.position_floor_m**2 * np.eye(2)
        self._xy, self._own = xy, own_covariance(covariance, policy)
        self._contributor = np.array([find.contributor for find in finds])
        self._members: list[list[int]] = [[slot] for slot in range(len(finds))]
        self._places, self._covariances = xy.copy(), self._own + self._common
        self._sign: list[str | None] = [find.sign for find in finds]
        self._value: list[str | None] = [find.value for find in finds]
        self._together = _seen_together(finds)
        self.alive = np.ones(len(finds), bool)
        self._cost = np.full((len(finds), len(finds)), np.inf)
        for slot in range(len(finds)):
            self._cost[slot] = self._row(slot)
        self.nearest = self._cost.argmin(axis=1)
        self.best = self._cost.min(axis=1)

    def merge(self, slot: int, gone: int) -> None:
        """Merge the cluster in the slot `gone` into the lower slot `slot`."""
        members = sorted(self._members[slot] + self._members[gone])
        self._members[slot] = members
        means, spreads, _ = per_contributor(
            self._xy[members], self._own[members], self._contributor[members], self._common
        )
        self._places[slot], self._covariances[slot] = information_mean(means, spreads)
        self._sign[slot] = self._sign[slot] or self._sign[gone]
        self._value[slot] = self._value[slot] or self._value[gone]
        self._together[slot] |= self._together[gone]
        self._together[:, slot] |= self._together[:, gone]
        self.alive[gone] = False

        self._cost[gone] = self._cost[:, gone] = np.inf
        self._cost[slot] = self._cost[:, slot] = self._row(slot)
        # only rows whose nearest changed have to be searched again
        stale = np.flatnonzero(self.alive & ((self.nearest == slot) | (self.nearest == gone)))
        stale = np.union1d(stale, [slot])
        self.nearest[stale] = self._cost[stale].argmin(axis=1)
        closer = (self._cost[:, slot] < self.best) | ((self._cost[:, slot] == self.best) & (slot < self.nearest))
        self.nearest[closer] = slot
        self.best = self._cost[np.arange(len(self.best)), self.nearest]

    def part(self, slot: int) -> Part:
        """Return the cluster in a slot."""
        return Part(
            tuple(self._members[slot]), self._places[slot], self._covariances[slot], self._sign[slot], self._value[slot]
        )

    def _row(self, slot: int) -> Array:
        """Return what merging a slot with each other slot costs, (N,); infinite where it is not allowed."""
        costs = pair_costs(self._places[slot], self._covariances[slot], self._places, self._covariances, self._policy)
        allowed = self.alive & ~self._together[slot]
        allowed[slot] = False
        for other in np.flatnonzero(allowed & np.isfinite(costs)).tolist():
            if not (
                compatible(self._sign[slot], self._sign[other]) and compatible(self._value[slot], self._value[other])
            ):
                allowed[other] = False
        return np.where(allowed, costs, np.inf)


def _seen_together(finds: Sequence[Find]) -> NDArray[np.bool_]:
    """Return (N, N), which finds one session had in view at the same time: different objects."""
    session = np.array([find.session for find in finds])
    start, end = np.array([find.start for find in finds]), np.array([find.end for find in finds])
    together = np.asarray(session[:, None] == session, bool)
    together &= (start[:, None] <= end) & (start <= end[:, None])
    np.fill_diagonal(together, val=False)
    return together
