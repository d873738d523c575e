"""What time leaves of evidence: applied when reading, from the last informative contribution on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.law import FoldedState, Side
from slamcu_core.aggregation.policy import ClassPolicy

Array = NDArray[np.float64]

_DAY_S = 86400.0


def decayed(state: FoldedState, as_of: float, policy: ClassPolicy) -> tuple[float, float]:
    """Return F and A as they read at a POSIX time: halved for each half-life since the last informative contribution.

    A prior that nobody has looked at does not decay, and nothing decays backwards.
    """
    kept = kept_at(state.last_informative, as_of, policy)
    return kept * state.weight_for, kept * state.weight_against


def kept_at(last_informative: float | None, as_of: float, policy: ClassPolicy) -> float:
    """Return in (0, 1] what is left at a POSIX time of weights whose last informative contribution is of another."""
    if last_informative is None:
        return 1.0
    return float(0.5 ** (max(as_of - last_informative, 0.0) / _DAY_S / policy.half_life_days))


def fades_at(state: FoldedState, policy: ClassPolicy, side: Side, mass: float) -> float | None:
    """Return the POSIX time from which the mass on a side reads below `mass` in (0, 1) if no news comes.

    A side that is below it already (it stands on as long as too few have spoken against it) fades when it would be
    below undisputed. None: nothing has been said that speaks for the side.
    """
    return fades_each([state], policy, side, [mass])[0]


def fades_each(
    states: Sequence[FoldedState], policy: ClassPolicy, side: Side, masses: Sequence[float]
) -> list[float | None]:
    """Return for each of many states when it fades: what `fades_at` says of it."""
    own = np.array([state.weight_for for state in states], float)
    other = np.array([state.weight_against for state in states], float)
    if side is Side.DELETED:
        own, other = other, own
    speaks = np.array([state.last_informative is not None for state in states], bool) & (own > 0.0)
    kept = np.ones(len(states))
    if speaks.any():
        kept[speaks] = _kept_at_mass(own[speaks], other[speaks], np.asarray(masses, float)[speaks])
    ages = -np.log2(kept) * policy.half_life_days * _DAY_S
    return [
        state.last_informative + age if speaking and state.last_informative is not None else None
        for state, age, speaking in zip(states, ages.tolist(), speaks.tolist(), strict=True)
    ]


def _kept_at_mass(own: Array, other: Array, mass: Array) -> Array:
    """Return what must be left (N,) of weights for the mass on the side of `own` to read `mass`."""
    logit = np.log(mass / (1.0 - mass))

    def excess(kept: Array) -> Array:
        """Return the logit of the mass on the side over that of `mass`: concave in what is kept, -inf at 0."""
        return np.asarray(kept * own + np.log(-np.expm1(-kept * own)) - kept * other - logit)

    below = excess(np.ones(len(own))) < 0.0
    low, kept = np.zeros(len(own)), np.ones(len(own))
    for _ in range(60):
        middle = 0.5 * (low + kept)
        above = excess(middle) >= 0.0
        low, kept = np.where(above, low, middle), np.where(above, middle, kept)
    return np.where(below, np.minimum(-np.log1p(-mass) / own, 1.0), kept)
