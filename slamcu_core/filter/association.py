"""Pre-association of section 4.3.1: likelihoods averaged over the particles, gated, assigned one to one (errata)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.assignment import assign
from slamcu_core.geometry import mahalanobis_square
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]


class Marginal(NamedTuple):
    """The predicted measurement of F features with the particles averaged out.

    `mean` (2, F) and `covariance` (3, F) are in measurement space and hold the spread of the particles, the feature's
    own uncertainty and the calibration's, but no measurement noise.
    """

    mean: Array
    covariance: Array


def marginalise(predicted: Array, weights: Array, extra: Array, scratch: Array) -> Marginal:
    """Average predicted measurements (2, F, M) over the particles.

    `extra` (3, F) is added to their covariance, in place; `scratch` (2, F, M) is memory to work in.
    """
    mean = predicted @ weights
    weighted = np.multiply(predicted, weights, out=scratch)
    # about 0: of a range of 100 m and a spread of 1 mm that leaves six digits, and R is added yet
    extra[::2] += np.vecdot(weighted, predicted) - mean * mean
    extra[1] += np.vecdot(weighted[0], predicted[1]) - mean[0] * mean[1]
    return Marginal(mean, extra)


def associate(
    model: SensorModel,
    detections: tuple[Array, Array],
    marginal: Marginal,
    log_prior: Array,
    *,
    log_unknown: Array,
    gate: float,
) -> tuple[NDArray[np.intp], Array, Array]:
    """Assign D detections to F features, one to one.

    Parameters
    ----------
    detections : (2, D) measurements, and (2, D) variances of R.
    marginal : predicted measurements of the features.
    log_prior : (D, F) log of how likely the feature shows itself, with the fit of class, sign and value; -inf where
        a detection cannot be that feature.
    log_unknown : (D,) ln of the density of false alarms and of things that nobody knows of.
    gate : chi-square threshold on the innovation.

    Returns
    -------
    The feature of each detection or -1, (D,), the normalised innovations squared, (D, F), and ln of how much likelier
    each feature is than something unknown, (D, F), -inf beyond the gate.
    """
    measurements, noise = detections
    nu = model.innovation(measurements[:, :, None], marginal.mean[:, None, :])
    xx, xy, yy = marginal.covariance[0], marginal.covariance[1], marginal.covariance[2]
    square, determinant = mahalanobis_square(nu, (xx + noise[0, :, None], xy, yy + noise[1, :, None]))
    # ln N(ν; 0, Q) - ln(density of the unknown)
    score = np.log(determinant)
    score += square
    score *= -0.5
    score += log_prior
    score -= math.log(2.0 * math.pi) + log_unknown[:, None]
    np.putmask(score, square > gate, -np.inf)
    return assign(score), square, score
