"""What time leaves of evidence: applied when reading, from the last informative contribution on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation.law import FoldedState, Side
from slamcu_core.aggregation.policy import ClassPolicy

Array = NDArray[np.float64]

_DAY_S = 86400.0
_STEPS = 100  # of Newton's; rounding ends them after five to ten


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
    last = np.array([np.nan if state.last_informative is None else state.last_informative])
    weights = np.array([state.weight_for]), np.array([state.weight_against])
    (told,) = fades_each(*weights, last, np.array([mass]), policy=policy, side=side).tolist()
    return None if math.isnan(told) else told


def fades_each(
    weight_for: Array, weight_against: Array, last_informative: Array, masses: Array, *, policy: ClassPolicy, side: Side
) -> Array:
    """Return when each of N states fades, (N,) in s of POSIX time: what `fades_at` says of it, NaN for None.

    Parameters
    ----------
    last_informative : (N,), s of POSIX time, NaN for never.
    """
    own, other = (weight_against, weight_for) if side is Side.DELETED else (weight_for, weight_against)
    fades = np.full(len(own), np.nan)
    speaks = np.flatnonzero(~np.isnan(last_informative) & (own > 0.0))
    if speaks.size:
        ages = -np.log2(_kept_at_mass(own[speaks], other[speaks], masses[speaks])) * policy.half_life_days * _DAY_S
        fades[speaks] = last_informative[speaks] + ages
    return fades


def _kept_at_mass(own: Array, other: Array, mass: Array) -> Array:
    """Return what must be left (N,) of weights for the mass on the side of `own` to read `mass`."""
    logit = np.log(mass / (1.0 - mass))

    def excess(kept: Array) -> Array:
        """Return the logit of the mass on the side over that of `mass`: concave in what is kept, -inf at 0."""
        return np.asarray(kept * own + np.log(-np.expm1(-kept * own)) - kept * other - logit)

    # Undisputed it reads the mass where less is left. From there Newton's steps rise to the root, as tangents of a
    # concave function do, until rounding ends them: each of its own, with whatever others it is asked.
    kept = np.minimum(-np.log1p(-mass) / own, 1.0)
    rising = excess(np.ones(len(own))) >= 0.0
    for _ in range(_STEPS):
        with np.errstate(divide="ignore", invalid="ignore"):  # where there is no root
            further = kept - excess(kept) / (own / -np.expm1(-kept * own) - other)
        rising &= further > kept
        if not rising.any():
            break
        kept = np.where(rising, further, kept)
    return kept
