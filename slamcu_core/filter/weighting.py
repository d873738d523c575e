"""Importance weights, eq. 17-19 with the errata: log domain, map uncertainty, tempered, floored for outliers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcu_core.geometry import mahalanobis_square

Array = NDArray[np.float64]


def gaussian_log_likelihood(innovation: Array, covariance: Array) -> Array:
    """Return ln N(ν; 0, Q) for innovations (2, ...) with covariances (3, ...): eq. 17 and 18 with -½."""
    square, determinant = mahalanobis_square(innovation, covariance)
    determinant *= (2.0 * np.pi) ** 2
    square += np.log(determinant)
    square *= -0.5
    return square


def robust_log_likelihood(log_likelihood: Array, log_clutter: float, outlier_share: float) -> Array:
    """Mix a likelihood with the clutter density, so that one wrong association cannot kill the true particles."""
    if outlier_share == 0.0:
        return log_likelihood
    floor = math.log(outlier_share) + log_clutter
    above = log_likelihood + (math.log1p(-outlier_share) - floor)
    # ln(exp(inlier) + exp(floor)); numpy's logaddexp and log1p are several times slower
    rest = np.abs(above)
    np.negative(rest, out=rest)
    np.exp(rest, out=rest)
    rest += 1.0
    np.maximum(above, 0.0, out=above)
    above += np.log(rest, out=rest)
    above += floor
    return np.asarray(above)


def combine(log_weight: Array, log_likelihoods: Array, temper: float) -> Array:
    """Return ω_t = ω_HD × ω_new × ω_{t-1} (eq. 19) in the log domain.

    Parameters
    ----------
    log_weight : (M,) before.
    log_likelihoods : (A, M) of all associated measurements, of map and new features alike.
    temper : exponent in (0, 1] for frames that share their errors (errata to section 6.2).
    """
    return np.asarray(log_weight + temper * np.add.reduce(log_likelihoods, axis=0))
