"""What time leaves of evidence: applied when reading, from the last informative contribution on."""

from __future__ import annotations

import math

from slamcu_core.aggregation.law import FoldedState, Side
from slamcu_core.aggregation.policy import ClassPolicy

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
    own, other = state.weight_for, state.weight_against
    if side is Side.DELETED:
        own, other = other, own
    if state.last_informative is None or own <= 0.0:
        return None
    logit = math.log(mass / (1.0 - mass))

    def excess(kept: float) -> float:
        """Return the logit of the mass on the side over that of `mass`: concave in what is kept, -inf at 0."""
        return kept * own + math.log(-math.expm1(-kept * own)) - kept * other - logit

    if excess(1.0) < 0.0:
        kept = min(-math.log1p(-mass) / own, 1.0)
    else:
        low, kept = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + kept)
            low, kept = (low, middle) if excess(middle) >= 0.0 else (middle, kept)
    return state.last_informative - math.log2(kept) * policy.half_life_days * _DAY_S
