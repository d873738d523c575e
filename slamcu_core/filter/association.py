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

    `mean` (2, F) and `covariance` (2, 2, F) are in measurement space and hold the spread of the particles, the
    feature's own uncertainty and the calibration's, but no measurement noise.
    """

    mean: Array
    covariance: Array


def marginalise(model: SensorModel, predicted: Array, weights: Array, extra: Array) -> Marginal:
    """Average predicted measurements (2, F, M) over particles; `extra` (2, 2, F) is added to their covariance."""
    reference = predicted[:, :, int(weights.argmax())]
    delta = model.innovation(predicted, reference[:, :, None])
    offset = delta @ weights
    delta -= offset[:, :, None]
    weighted = delta * weights
    cross = np.einsum("fk,fk->f", weighted[0], delta[1])
    extra[0, 0] += np.einsum("fk,fk->f", weighted[0], delta[0])
    extra[1, 1] += np.einsum("fk,fk->f", weighted[1], delta[1])
    extra[0, 1] += cross
    extra[1, 0] += cross
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
    covariance = np.repeat(marginal.covariance[:, :, None], measurements.shape[1], axis=2)
    covariance[0, 0] += noise[0, :, None]
    covariance[1, 1] += noise[1, :, None]
    square, determinant = mahalanobis_square(nu, covariance)
    # ln N(ν; 0, Q) - ln(clutter density)
    score = log_prior - 0.5 * (square + np.log(determinant)) - (math.log(2.0 * math.pi) + model.log_clutter)
    score[square > gate] = -np.inf
    return assign(score), square
