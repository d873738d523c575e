"""The finds of many connected groups side by side, as arrays: what merging them needs to know of each.

Groups of like size lie in one batch, padded to a power of two that follows from a group's own size, and all arithmetic
is element by element: so a group's numbers are the same bits with whatever it is laid out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.policy import ClassPolicy
from slamcu_core.geometry import inverse, times

Array = NDArray[np.float64]
Codes = NDArray[np.intp]
Flags = NDArray[np.bool_]

_SAME_PLACE_M = 1e-3
_PAIRS_AT_ONCE = 1 << 16  # of one batch: its arrays stay in the processor's cache


@dataclass(frozen=True, slots=True)
class Find:
    """What one pass found, as far as identity goes."""

    session: int  # a code: equal for passes of one session
    start: float  # s
    end: float  # s
    sign: str | None
    value: str | None


@dataclass(frozen=True, slots=True)
class Group:
    """The N finds of one class and one connected group, in canonical order."""

    xy: Array  # (N, 2), m
    covariance: Array  # (N, 2, 2), m²
    finds: Sequence[Find]


@dataclass(frozen=True, slots=True)
class Batch:
    """G groups of at most N finds each; components come first."""

    present: Flags  # (G, N), what is no padding
    xy: Array  # (2, G, N), m
    covariance: Array  # (3, G, N), xx, xy and yy, m²
    information: Array  # (3, G, N), its inverse
    vector: Array  # (2, G, N), information times place
    together: Flags  # (G, N, N), seen together: different objects
    names: Codes  # (2, G, N), codes of sign and value, 0 where nobody could tell
    texts: Sequence[str | None]  # by code
    policy: ClassPolicy

    @classmethod
    def of(cls, groups: Sequence[Group], policy: ClassPolicy) -> Batch:
        """Lay groups out."""
        size = _padded(max(len(group.finds) for group in groups))
        present = np.arange(size) < np.array([len(group.finds) for group in groups])[:, None]
        codes: dict[str | None, int] = {None: 0}
        cards = [find for group in groups for find in group.finds]
        columns = np.zeros((7, *present.shape))
        columns[2], columns[4] = 1.0, 1.0  # padding: any covariance that can be inverted
        columns[:5, present] = np.concatenate(
            [np.column_stack([group.xy, group.covariance.reshape(-1, 4)[:, [0, 1, 3]]]) for group in groups]
        ).T
        columns[5:, present] = np.array([(find.start, find.end) for find in cards]).T
        names = np.zeros((2, *present.shape), np.intp)
        names[:, present] = np.array(
            [[codes.setdefault(name, len(codes)) for name in (find.sign, find.value)] for find in cards]
        ).T
        session = np.full(present.shape, -1)
        session[present] = [find.session for find in cards]
        xy, covariance = columns[:2], columns[2:5]
        information = inverse(covariance)
        vector = times(information, xy)
        together = _seen_together(xy, session, columns[5], columns[6]) & present[:, :, None] & present[:, None, :]
        return cls(present, xy, covariance, information, vector, together, names, tuple(codes), policy)


def batches(groups: Sequence[Group]) -> Iterator[list[int]]:
    """Yield the numbers of groups of two finds and more, as they are best laid out together."""
    sizes = [_padded(len(group.finds)) for group in groups]
    several = sorted((number for number, size in enumerate(sizes) if size > 1), key=lambda number: sizes[number])
    for size, alike in groupby(several, key=lambda number: sizes[number]):
        numbers, most = list(alike), max(1, _PAIRS_AT_ONCE // size**2)
        yield from (numbers[at : at + most] for at in range(0, len(numbers), most))


def sums_over(label: Codes, values: Array, slots: int) -> Array:
    """Add up values (K, G, N) by the slot (G, N) that each find is in, and return (K, G, S); below 0 is no slot."""
    made = np.zeros((len(values), len(label), slots + 1))
    rows = np.arange(len(label))
    for find in range(label.shape[1]):  # in canonical order, whatever the padding
        made[:, rows, label[:, find]] += values[:, :, find]
    return made[:, :, :slots]


def named(label: Codes, names: Codes, slots: int) -> Codes:
    """Return what the finds (2, G, N) in each slot say it is, (2, G, S): sign and value that the first can tell."""
    made = np.zeros((2, len(label), slots + 1), np.intp)
    rows = np.arange(len(label))
    for find in range(label.shape[1] - 1, -1, -1):
        at = rows, label[:, find]
        made[:, *at] = joint(names[:, :, find], made[:, *at])
    return made[:, :, :slots]


def joint(one: Codes, other: Codes) -> Codes:
    """Return what compatible names say together: the sign and value that either knows."""
    return np.where(one > 0, one, other)


def _padded(size: int) -> int:
    return 1 << (size - 1).bit_length()


def _seen_together(xy: Array, session: Codes, start: Array, end: Array) -> Flags:
    """Return (G, N, N), which finds one session had in view at the same time: different objects.

    The same times at the same place are one find told twice; else a message sent again under new ids would be as many
    objects as it has copies.
    """
    together = np.asarray(session[:, :, None] == session[:, None], bool)
    together[:, range(session.shape[1]), range(session.shape[1])] = False
    if not together.any():
        return together
    together &= (start[:, :, None] <= end[:, None]) & (start[:, None] <= end[:, :, None])
    told_twice = (start[:, :, None] == start[:, None]) & (end[:, :, None] == end[:, None])
    told_twice &= (np.abs(xy[..., :, None] - xy[..., None, :]) <= _SAME_PLACE_M).all(axis=0)
    return np.asarray(together & ~told_twice)
