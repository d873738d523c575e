"""The stored passes over many things as arrays: what is counted and folded side by side, one thing like the other."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation import PassColumns
from slamcu_server.aggregation.passes import StoredPass

Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class PassTable:
    """P passes over T things, in order of the things and in canonical order of the passes of each."""

    passes: tuple[StoredPass, ...]
    things: int
    thing: Indices  # (P,), from 0
    ended_at: NDArray[np.float64]  # (P,), s of POSIX time
    valid: Flags  # (P,)
    trusted: Flags
    blocked: Flags
    found: Flags

    @classmethod
    def of(cls, things: Sequence[Iterable[StoredPass]]) -> PassTable:
        """Return the table of some passes over each of some things."""
        ordered = [sorted(passes, key=lambda item: item.order) for passes in things]
        passes = tuple(item for mine in ordered for item in mine)
        return cls(
            passes,
            len(ordered),
            np.repeat(np.arange(len(ordered)), [len(mine) for mine in ordered]),
            np.array([item.ended_at.timestamp() for item in passes], float),
            np.array([item.valid for item in passes], bool),
            np.array([item.trusted for item in passes], bool),
            np.array([item.blocked for item in passes], bool),
            np.array([item.found for item in passes], bool),
        )

    @property
    def counts(self) -> Flags:
        """(P,), whether a pass is evidence by itself."""
        return np.asarray(self.valid & self.trusted)

    def columns(self) -> PassColumns:
        """Return what the law folds."""
        weight_for, weight_against = np.array([item.weights for item in self.passes], float).reshape(-1, 2).T.copy()
        return PassColumns(
            self.thing,
            np.array([item.contributor for item in self.passes], np.int64),
            self.ended_at,
            weight_for,
            weight_against,
            None if self.trusted.all() else ~self.trusted,
        )

    def count(self, chosen: Flags) -> Indices:
        """Return (T,), how many of the chosen passes each thing has."""
        return np.bincount(self.thing[chosen], minlength=self.things)

    def first(self, chosen: Flags) -> Indices:
        """Return (T,), the number of the first of the chosen passes over each thing, -1 for none."""
        return self._one(np.flatnonzero(chosen)[::-1])

    def last(self, chosen: Flags) -> Indices:
        """Return (T,), the number of the last of the chosen passes over each thing, -1 for none."""
        return self._one(np.flatnonzero(chosen))

    def _one(self, numbers: Indices) -> Indices:
        one = np.full(self.things, -1, np.intp)
        one[self.thing[numbers]] = numbers  # the last of each is written last
        return one

    def ends(self, numbers: Indices) -> list[datetime | None]:
        """Return when the passes of these numbers ended, None for -1."""
        return [None if number < 0 else self.passes[number].ended_at for number in numbers.tolist()]

    def ids_of(self, chosen: Flags) -> dict[int, tuple[int, ...]]:
        """Return the ids of the chosen passes, in ascending order, of the things that have any."""
        ids: defaultdict[int, list[int]] = defaultdict(list)
        for number in np.flatnonzero(chosen).tolist():
            ids[int(self.thing[number])].append(self.passes[number].id)
        return {thing: tuple(sorted(mine)) for thing, mine in ids.items()}
