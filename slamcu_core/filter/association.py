"""Pre-association of section 4.3.1: likelihoods averaged over the particles, gated, assigned one to one (errata)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.assignment import assign
from slamcu_core.filter.ekf import mahalanobis_square
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Marginal:
    """The predicted measurement of F features with the particles averaged out.

    `mean` (2, F) and `covariance` (3, F) are in measurement space and hold the spread of the particles, the feature's
    own uncertainty and the calibration's, but no measurement noise.
    """

    mean: Array
    covariance: Array


def marginalise(deviation: Array, weights: Array, reference: Array, extra: Array, scratch: Array) -> Marginal:
    """Average predicted measurements over the particles.

    They are given as deviations (2, F, M) from reference measurements (2, F); `extra` (3, F) is added to their
    covariance, in place; `scratch` (2, F, M) is memory to work in.
    """
    offset = deviation @ weights
    weighted = np.multiply(deviation, weights, out=scratch)
    extra[0] += np.vecdot(weighted[0], deviation[0]) - offset[0] * offset[0]
    extra[1] += np.vecdot(weighted[0], deviation[1]) - offset[0] * offset[1]
    extra[2] += np.vecdot(weighted[1], deviation[1]) - offset[1] * offset[1]
    return Marginal(reference + offset, extra)


def associate(
    model: SensorModel, detections: tuple[Array, Array], marginal: Marginal, log_prior: Array, gate: float
) -> tuple[NDArray[np.intp], Array]:
    """Assign D detections to F features, one to one.

    Parameters
    ----------
    detections : (2, D) measurements, and (2, D) variances of R.
    marginal : predicted measurements of the features.
    log_prior : (D, F) log of how likely the feature shows itself, with the fit of class, sign and value; -inf where
        a detection cannot be that feature.
    gate : chi-square threshold on the innovation.

    Returns
    -------
    The feature of each detection or -1, (D,), and the normalised innovations squared, (D, F).
    """
    measurements, noise = detections
    nu = model.innovation(measurements[:, :, None], marginal.mean[:, None, :])
    xx, xy, yy = marginal.covariance
    square, determinant = mahalanobis_square(nu, (xx + noise[0, :, None], xy, yy + noise[1, :, None]))
    # ln N(ν; 0, Q) - ln(clutter density)
    score = np.log(determinant)
    score += square
    score *= -0.5
    score += log_prior
    score -= math.log(2.0 * math.pi) + model.log_clutter
    score[square > gate] = -np.inf
    return assign(score), square
