"""Weights of evidence: coordinates in which Dempster's rule (eq. 5-7) is addition.

Masses on {exists, not} are a triple (e, n, u) with u = m(Ω) > 0. With f = ln(1 + e/u) and a = ln(1 + n/u) the
combination of two sources adds their f and adds their a; any number of reports can be added without overflow.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.errors import EvidenceError

Array = NDArray[np.float64]

LAMBDA_MAX = 0.99
"""The largest existence confidence that one observation may carry: λ = 1 would be dogma that nothing can unmake."""

LN_2 = float(np.log(2.0))
"""The weight above which a mass is larger than what is unknown: e > u where exp(f) - 1 > 1."""


def clamp_confidence(confidence: ArrayLike) -> Array:
    """Clamp existence confidences λ in [0, 1] to at most LAMBDA_MAX.

    Raises EvidenceError where λ is not a number in [0, 1].
    """
    lam = np.asarray(confidence, float)
    if not np.all((lam >= 0.0) & (lam <= 1.0)):
        raise EvidenceError(f"an existence confidence must lie in [0, 1], not {confidence!r}")
    return np.asarray(np.minimum(lam, LAMBDA_MAX))


def support(confidence: ArrayLike) -> Array:
    """Return the weight -ln(1 - λ) of simple support: eq. 1 adds it to f, eq. 2 to a, and eq. 3 starts f with it.

    A vacuous observation (λ = 0, eq. 4) weighs nothing. λ above LAMBDA_MAX is clamped.
    """
    return np.asarray(-np.log1p(-clamp_confidence(confidence)))


@lru_cache(4096)
def support_of(confidence: float) -> float:
    """Return the weight of simple support of one confidence, as `support` does of many; few differ."""
    return float(support(confidence))


def masses_from_weights(weight_for: ArrayLike, weight_against: ArrayLike) -> tuple[Array, Array, Array]:
    """Return the masses (e, n, u) of weights f, a >= 0 (any shape that broadcasts).

    Z = exp(f) + exp(a) - 1, e = (exp(f) - 1)/Z, n = (exp(a) - 1)/Z, u = 1/Z, each multiplied through by
    exp(-max(f, a)) so that weights of 10⁷ neither overflow nor lose the normalisation.
    """
    f, a = np.asarray(weight_for, float), np.asarray(weight_against, float)
    top = np.maximum(f, a)
    # exp(f - top) - exp(-top) = exp(-top)(exp(f) - 1), written so that small f keep their digits
    e = np.exp(f - top) * -np.expm1(-f)
    n = np.exp(a - top) * -np.expm1(-a)
    u = np.exp(-top)
    z = e + n + u
    return e / z, n / z, u / z


def weights_from_masses(exists: ArrayLike, not_exists: ArrayLike, unknown: ArrayLike) -> tuple[Array, Array]:
    """Return the weights (f, a) of masses (e, n, u) with u > 0.

    Raises EvidenceError where a mass is negative, u is not positive or the masses do not sum to one.
    """
    e, n, u = np.asarray(exists, float), np.asarray(not_exists, float), np.asarray(unknown, float)
    if not (np.all(e >= 0.0) and np.all(n >= 0.0) and np.all(u > 0.0)):
        raise EvidenceError("masses must be at least 0, and the mass of the unknown above 0")
    if not np.allclose(e + n + u, 1.0, rtol=0.0, atol=1e-9):
        raise EvidenceError("the three masses must sum to 1")
    return _weight(e, u), _weight(n, u)


def _weight(mass: Array, unknown: Array) -> Array:
    """Return ln(1 + mass / unknown); a ratio that leaves the range of a double is taken as a difference of logs."""
    with np.errstate(over="ignore"):
        ratio = mass / unknown
    weight = np.asarray(np.log1p(ratio))
    if (beyond := ~np.isfinite(ratio)).any():
        weight = np.where(beyond, np.log(mass + unknown) - np.log(unknown), weight)
    return weight


def conflict(weight_for: ArrayLike, weight_against: ArrayLike) -> Array:
    """Return the mass of the empty set before normalisation (eq. 7), (1 - exp(-f))(1 - exp(-a))."""
    f, a = np.asarray(weight_for, float), np.asarray(weight_against, float)
    return np.asarray(np.expm1(-f) * np.expm1(-a))
