"""Which places can have to do with each other: the connected groups of points within a reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.errors import EvidenceError

Array = NDArray[np.float64]

_AHEAD = [(dx, dy) for dx in range(3) for dy in range(-2, 3) if (dx, dy) > (0, 0)]


def connected_groups(xy: ArrayLike, reach_m: float) -> NDArray[np.intp]:
    """Label the groups of points that steps of at most `reach_m` connect.

    Passes of different groups never share a cluster if `reach_m` is at least the policy's `reach_m`, so a caller that
    takes whole groups loses nothing.

    Parameters
    ----------
    xy : (N, 2) m.

    Returns
    -------
    (N,) labels from 0, numbered by first appearance.

    Raises EvidenceError if a place is not finite or the reach not positive.
    """
    points = np.asarray(xy, float).reshape(-1, 2)
    if not np.isfinite(points).all():
        raise EvidenceError("positions must be finite")
    if not reach_m > 0.0:
        raise EvidenceError(f"the reach must be above 0, not {reach_m}")
    if not len(points):
        return np.zeros(0, np.intp)
    # Points that share a cell with sides reach/√2 are always connected, so only whole cells have to be joined.
    cells = np.floor(points / (reach_m / np.sqrt(2.0) * (1.0 - 1e-12))).astype(np.int64).tolist()
    members: dict[tuple[int, int], list[int]] = {}
    for number, (x, y) in enumerate(cells):
        members.setdefault((x, y), []).append(number)
    index = {key: number for number, key in enumerate(members)}
    parent = list(range(len(index)))
    for (x, y), one in index.items() if len(index) > 1 else ():
        for dx, dy in _AHEAD:
            key = x + dx, y + dy
            other = index.get(key)
            if other is None or root_of(parent, one) == root_of(parent, other):
                continue
            if _touch(points[members[x, y]], points[members[key]], reach_m):
                parent[root_of(parent, one)] = root_of(parent, other)
    label = np.empty(len(points), np.intp)
    numbers: dict[int, int] = {}
    for cell, inside in enumerate(members.values()):  # in order of their first points
        label[inside] = numbers.setdefault(root_of(parent, cell), len(numbers))
    return label


def root_of(parent: list[int], node: int) -> int:
    """Return the root of a node in a union-find forest, halving the path to it."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


def _touch(one: Array, other: Array, reach_m: float) -> bool:
    """Whether a point of (N, 2) lies within reach of a point of (M, 2), row by row to bound the memory."""
    return any(bool((np.square(other - point).sum(axis=1) <= reach_m**2).any()) for point in one)
