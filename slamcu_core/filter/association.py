"""Pre-association of section 4.3.1: likelihoods averaged over the particles, gated, assigned one to one (errata)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.assignment import assign
from slamcu_core.filter.ekf import inverse_2x2
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Marginal:
    """The predicted measurement of F features with the particles averaged out.

    `mean` (F, 2) and `covariance` (F, 2, 2) are in measurement space and hold the spread of the particles, the
    feature's own uncertainty and the calibration's, but no measurement noise.
    """

    mean: Array
    covariance: Array


def marginalise(model: SensorModel, predicted: Array, weights: Array, extra: Array) -> Marginal:
    """Average predicted measurements (M, F, 2) over particles; `extra` (F, 2, 2) is added to their covariance."""
    reference = predicted[int(np.argmax(weights))]
    delta = model.innovation(predicted, reference)
    offset = np.einsum("k,kfi->fi", weights, delta)
    centred = delta - offset
    covariance = np.einsum("k,kfi,kfj->fij", weights, centred, centred)
    return Marginal(reference + offset, covariance + extra)


def associate(
    model: SensorModel, detections: tuple[Array, Array], marginal: Marginal, log_prior: Array, gate: float
) -> tuple[NDArray[np.intp], Array]:
    """Assign D detections to F features, one to one.

    Parameters
    ----------
    detections : (D, 2) measurements, and (D, 2) variances of R.
    marginal : predicted measurements of the features.
    log_prior : (D, F) log of how likely the feature shows itself, with the fit of class, sign and value; -inf where
        a detection cannot be that feature.
    gate : chi-square threshold on the innovation.

    Returns
    -------
    The feature of each detection or -1, (D,), and the normalised innovations squared, (D, F).
    """
    measurements, noise = detections
    nu = model.innovation(measurements[:, None, :], marginal.mean[None, :, :])
    covariance = np.repeat(marginal.covariance[None], len(measurements), axis=0)
    covariance[..., 0, 0] += noise[:, None, 0]
    covariance[..., 1, 1] += noise[:, None, 1]
    inverse, determinant = inverse_2x2(covariance)
    square = np.einsum("dfi,dfij,dfj->df", nu, inverse, nu)
    log_likelihood = -0.5 * square - np.log(2.0 * np.pi) - 0.5 * np.log(determinant)
    score = log_prior + log_likelihood - np.log(model.clutter_density)
    score[square > gate] = -np.inf
    return assign(score), square
