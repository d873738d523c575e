"""Whose word counts of those who said that they are not to be trusted: many who doubt in one place, and agree.

A car that is lost misses what the map has, and so does one on a road that is no longer the map's: neither can tell
which of both it is. Many can, because those who are lost miss what others see, and find what nobody else finds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.policy import ClassPolicy

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

HAS_LOOKED = 0.5
"""Informativeness from which a contribution knows more than it does not: a lesser miss contradicts nobody."""


def heard(
    feature: NDArray[np.intp],
    contributor: NDArray[np.int64],
    *,
    weight_for: Array,
    weight_against: Array,
    informativeness: Array,
    doubtful: Flags,
    policy: ClassPolicy,
) -> Flags:
    """Say of contributions (P,), in order of feature, time, then contributor, which ones fold.

    Those of trusted filters do. One in doubt does if `contributors_in_doubt` different contributors in doubt, it among
    them, say the same of the feature, and nobody, trusted or not, says the opposite in between. It takes as many to see
    as to miss: those who have seen what became of a sign have missed it, and so both halves of a change come at once.

    Parameters
    ----------
    weight_for, weight_against, informativeness : discounted.
    doubtful : whether the filter said that it is not to be trusted.
    """
    result = ~doubtful
    if not policy.contributors_in_doubt or not doubtful.any():
        return np.asarray(result)
    begins = np.diff(feature, prepend=-1) != 0
    sees, misses = weight_for > weight_against, weight_against > weight_for
    # what refutes, as to the quorum of a change: a glimpse is a sight, while a view that was blocked misses nothing
    sight, miss = sees & (weight_for >= policy.contributor_weight), misses & (informativeness >= HAS_LOOKED)
    for says, opposite in ((sees, miss), (misses, sight)):
        run = np.cumsum(begins | opposite)
        mine = np.flatnonzero(doubtful & says)
        voices = np.unique(np.stack([run[mine], contributor[mine]]), axis=1)[0]
        enough = np.bincount(voices) >= policy.contributors_in_doubt
        result[mine] |= enough[run[mine]]
    return np.asarray(result)
