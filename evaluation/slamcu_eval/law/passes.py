"""Passes without cars: what the law makes of streams of seen and missed, through the server's own fold.

The model. A feature is passed again and again, each time by another vehicle and in another hour, and every pass leaves
no doubt: it saw the feature, or it did not. A sign that stands is missed with the *miss rate*; where none stands a
pass sees one with the *phantom rate*. Both are independent from pass to pass. A pass that could not see changes nothing
in the law and is left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation import ClassPolicy, Histories, Side, discounted, fold_histories
from slamcu_core.evidence import support

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

PRIOR = float(support(0.95))  # λ_HD of a map that says nothing else (eq. 3)
FULL_WEIGHT = 20.0  # of a pass that leaves no doubt: what the discount leaves of it is -ln(1 - α)
LONG = 40  # passes after which a history is long: γ⁴⁰ of the beginning is left
_CHUNK = 1_000_000  # passes folded at a time, to bound the memory


@dataclass(frozen=True, slots=True)
class Rate:
    """How often something happened in a number of passes."""

    events: int
    passes: int

    @property
    def per_10000(self) -> float:
        """Events per 10⁴ passes."""
        return 1e4 * self.events / self.passes


def stands(missed: Flags, policy: ClassPolicy, side: Side) -> Flags:
    """Say after each pass, each by another vehicle, whether the change stands; (passes, features).

    A map feature starts from its prior, a candidate from nothing.
    """
    roomy = replace(policy, window=max(policy.window, len(missed)))
    f, a, w = discounted(np.where(missed, 0.0, FULL_WEIGHT), np.where(missed, FULL_WEIGHT, 0.0), policy.trust, roomy)
    who = np.broadcast_to(np.arange(len(missed))[:, None], missed.shape)
    deleted = side is Side.DELETED
    return fold_histories(Histories(f, a, w, who), PRIOR if deleted else 0.0, roomy, deleted=deleted).standing


def false_changes(
    policy: ClassPolicy,
    side: Side,
    rate: float,
    *,
    passes: int,
    after: int,
    length: int,
    stream: np.random.SeedSequence,
) -> Rate:
    """Count how often a change that is not so begins to stand.

    Parameters
    ----------
    rate : the miss rate of signs that stand (DELETED), the phantom rate where none stands (NEW). A candidate begins
        with a phantom: else it were none.
    passes : to be counted, over as many features as it takes.
    after : passes of each feature before those that count: 0 for a fresh map.
    length : passes of each feature that count.
    """
    events, features = 0, -(-passes // length)
    for number, rng in _chunks(features, after + length, stream):
        missed = rng.random((after + length, number)) < (rate if side is Side.DELETED else 1.0 - rate)
        if side is Side.NEW and after == 0:
            missed[0] = False
        standing = stands(missed, policy, side)
        began = standing[1:] & ~standing[:-1]
        events += int(began[max(after - 1, 0) :].sum()) + (int(standing[0].sum()) if after == 0 else 0)
    return Rate(events, features * length)


def delays(
    policy: ClassPolicy,
    side: Side,
    *,
    miss_rate: float,
    phantom_rate: float,
    before: int,
    features: int,
    stream: np.random.SeedSequence,
) -> Array:
    """Return how many passes it takes each of some features, (features,), until its change stands; inf if it does not.

    Parameters
    ----------
    before : DELETED: passes before the sign went, every one of which saw it: the worst that can have happened.
        NEW: 0, for the first pass that counts is the one that found it.
    """
    waiting = 3 * LONG
    rng = np.random.default_rng(stream)
    if side is Side.DELETED:
        missed = rng.random((waiting, features)) >= phantom_rate
        missed = np.vstack([np.zeros((before, features), bool), missed])
    else:
        missed = rng.random((waiting, features)) < miss_rate
        missed[0] = False
    standing = stands(missed, policy, side)[before:]
    return np.where(standing.any(axis=0), standing.argmax(axis=0) + 1.0, np.inf)


def _chunks(features: int, steps: int, stream: np.random.SeedSequence) -> Iterator[tuple[int, np.random.Generator]]:
    size = max(_CHUNK // steps, 1)
    starts = range(0, features, size)
    for start, child in zip(starts, stream.spawn(len(starts)), strict=True):
        yield min(size, features - start), np.random.default_rng(child)
