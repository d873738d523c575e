"""What is known of contributors: how much their word weighs, and whether they have a record."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.errors import EvidenceError


@dataclass(frozen=True, slots=True, eq=False)
class Trusts:
    """One version of the trust table; 0: before the first. Who is not in it has the policy's trust and no record."""

    version: int = 0
    contributor: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))  # (C,), ascending
    share: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))  # (C,), of the policy's α, in [0, 1]
    # (C,), s of POSIX time; has a record after it; inf: none
    proven_since: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not (len(self.contributor) == len(self.share) == len(self.proven_since)):
            raise EvidenceError("a trust table needs one share and one record for each contributor")
        if (np.diff(self.contributor) <= 0).any():
            raise EvidenceError("the contributors of a trust table must ascend")
        if not ((self.share >= 0.0) & (self.share <= 1.0)).all():
            raise EvidenceError("a contributor's share of the policy's trust must lie in [0, 1]")

    def shares(self, contributors: ArrayLike) -> NDArray[np.float64]:
        """Return the share of the policy's α that each contributor (any shape) has."""
        found, place = self._find(contributors)
        return np.where(found, self.share[place], 1.0) if self.contributor.size else np.ones(found.shape)

    def records(self, contributors: ArrayLike, times: ArrayLike) -> NDArray[np.bool_]:
        """Return which of the contributors (any shape) had a record when they spoke (same shape, s of POSIX time)."""
        found, place = self._find(contributors)
        return found & (np.asarray(times, float) > self.proven_since[place]) if self.contributor.size else found

    def _find(self, contributors: ArrayLike) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
        who = np.asarray(contributors, np.int64)
        if not self.contributor.size:
            return np.zeros(who.shape, bool), np.zeros(who.shape, np.intp)
        place = np.minimum(np.searchsorted(self.contributor, who), self.contributor.size - 1)
        return np.asarray(self.contributor[place] == who, bool), np.asarray(place, np.intp)
