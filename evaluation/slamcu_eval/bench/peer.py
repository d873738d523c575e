"""The peer of the bench: eq. 16-19 as plain FastSLAM code has them, particle by particle in Python loops.

Written from the paper's equations (with the errata that the filter follows) and not from the filter's code: scalars,
one particle and one measurement at a time. It takes the same poses, maps, measurements and associations as the filter
and gives the same weights, means and covariances; a test holds the two together to 1e-9.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import ekf, weighting
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StepInput:
    """One frame, associated: A measurements of known features and B of new ones, seen from M particles."""

    pose: Array  # (3, M)
    log_weight: Array  # (M,)
    map_place: Array  # (2, A) m
    map_covariance: Array  # (3, A) xx, xy, yy, m²
    map_measured: Array  # (2, A) m, rad
    means: Array  # (2, B, M) of the new features in each particle, m
    covariances: Array  # (3, B, M) m²
    new_measured: Array  # (2, B) m, rad
    map_noise: Array  # (2, A) variances of R
    new_noise: Array  # (2, B)
    log_clutter: float
    outlier_share: float
    temper: float


@dataclass(frozen=True, slots=True)
class StepOutput:
    """Weights (M,), and new features (2, B, M) and (3, B, M), after the frame."""

    log_weight: Array
    means: Array
    covariances: Array


def numpy_step(model: SensorModel, step: StepInput) -> StepOutput:
    """Do eq. 16-19 by the filter's own operations on arrays."""
    points = np.concatenate([np.repeat(step.map_place[:, :, None], len(step.log_weight), axis=2), step.means], axis=1)
    known = np.repeat(step.map_covariance[..., None], len(step.log_weight), axis=2)
    covariances = np.concatenate([known, step.covariances], axis=1)
    measured = np.concatenate([step.map_measured, step.new_measured], axis=1)[:, :, None]
    noise = np.concatenate([step.map_noise, step.new_noise], axis=1)[:, :, None]
    sight = model.sight(step.pose, points)
    jacobian = model.by_feature(sight)
    innovation = model.innovation(measured, sight.measurement)
    by_place = ekf.projected(jacobian, covariances)
    q = by_place + np.array([noise[0], np.zeros_like(noise[0]), noise[1]])
    likelihood = weighting.robust_log_likelihood(
        weighting.gaussian_log_likelihood(innovation, q), step.log_clutter, step.outlier_share
    )
    new = np.arange(step.map_place.shape[1], points.shape[1])
    means, spread = ekf.update(
        step.means, by_place[:, new], jacobian.some(new), innovation[:, new], noise[:, new] / step.temper
    )
    return StepOutput(weighting.combine(step.log_weight, likelihood, step.temper), means, spread)


def peer_step(step: StepInput) -> StepOutput:
    """Do eq. 16-19 for a range-bearing sensor at the vehicle's origin, one particle after the other."""
    log_weight, means, covariances = step.log_weight.copy(), step.means.copy(), step.covariances.copy()
    for k in range(len(log_weight)):
        x, y, heading = (float(value) for value in step.pose[:, k])
        total = 0.0
        for i in range(step.map_place.shape[1]):  # eq. 17
            place = float(step.map_place[0, i]), float(step.map_place[1, i])
            spread = _symmetric(step.map_covariance[:, i])
            seen = float(step.map_measured[0, i]), float(step.map_measured[1, i])
            noise = float(step.map_noise[0, i]), float(step.map_noise[1, i])
            _, nu, q = _innovate((x, y, heading), place, spread, seen, noise)
            total += _robust(_log_gaussian(nu, q), step.log_clutter, step.outlier_share)
        for i in range(step.means.shape[1]):  # eq. 18, then 16
            place = float(step.means[0, i, k]), float(step.means[1, i, k])
            spread = _symmetric(step.covariances[:, i, k])
            seen = float(step.new_measured[0, i]), float(step.new_measured[1, i])
            noise = float(step.new_noise[0, i]), float(step.new_noise[1, i])
            _, nu, q = _innovate((x, y, heading), place, spread, seen, noise)
            total += _robust(_log_gaussian(nu, q), step.log_clutter, step.outlier_share)
            tempered = noise[0] / step.temper, noise[1] / step.temper
            h, nu, q = _innovate((x, y, heading), place, spread, seen, tempered)
            moved, after = _kalman(place, spread, h, nu, q)
            means[:, i, k] = moved
            covariances[:, i, k] = after
        log_weight[k] += step.temper * total  # eq. 19
    return StepOutput(log_weight, means, covariances)


Pair = tuple[float, float]
Symmetric = tuple[float, float, float]  # xx, xy, yy


def _symmetric(matrix: Array) -> Symmetric:
    return float(matrix[0]), float(matrix[1]), float(matrix[2])


def _innovate(
    pose: tuple[float, float, float], place: Pair, spread: Symmetric, seen: Pair, noise: Pair
) -> tuple[tuple[float, float, float, float], Pair, Symmetric]:
    """Return H (row by row), z - ẑ with the bearing wrapped, and Q = H Σ Hᵀ + R."""
    dx, dy = place[0] - pose[0], place[1] - pose[1]
    distance = math.hypot(dx, dy)
    bearing = seen[1] - (math.atan2(dy, dx) - pose[2])
    nu = seen[0] - distance, math.atan2(math.sin(bearing), math.cos(bearing))
    a, b, c, d = dx / distance, dy / distance, -dy / distance**2, dx / distance**2
    xx, xy, yy = spread
    q = (
        a * a * xx + 2.0 * a * b * xy + b * b * yy + noise[0],
        a * c * xx + (a * d + b * c) * xy + b * d * yy,
        c * c * xx + 2.0 * c * d * xy + d * d * yy + noise[1],
    )
    return (a, b, c, d), nu, q


def _log_gaussian(nu: Pair, q: Symmetric) -> float:
    determinant = q[0] * q[2] - q[1] ** 2
    square = (nu[0] ** 2 * q[2] - 2.0 * nu[0] * nu[1] * q[1] + nu[1] ** 2 * q[0]) / determinant
    return -0.5 * square - math.log(2.0 * math.pi) - 0.5 * math.log(determinant)


def _robust(log_likelihood: float, log_clutter: float, outlier_share: float) -> float:
    inlier, outlier = math.log(1.0 - outlier_share) + log_likelihood, math.log(outlier_share) + log_clutter
    top = max(inlier, outlier)
    return top + math.log(math.exp(inlier - top) + math.exp(outlier - top))


def _kalman(
    mean: Pair, spread: Symmetric, h: tuple[float, float, float, float], nu: Pair, q: Symmetric
) -> tuple[Pair, Symmetric]:
    """Return mean and covariance after eq. 16: K = Σ Hᵀ Q⁻¹, μ + K (z - ẑ), (I - K H) Σ."""
    a, b, c, d = h
    xx, xy, yy = spread
    determinant = q[0] * q[2] - q[1] ** 2
    i00, i01, i11 = q[2] / determinant, -q[1] / determinant, q[0] / determinant
    s00, s01, s10, s11 = xx * a + xy * b, xx * c + xy * d, xy * a + yy * b, xy * c + yy * d  # Σ Hᵀ
    k00, k01 = s00 * i00 + s01 * i01, s00 * i01 + s01 * i11
    k10, k11 = s10 * i00 + s11 * i01, s10 * i01 + s11 * i11
    moved = mean[0] + k00 * nu[0] + k01 * nu[1], mean[1] + k10 * nu[0] + k11 * nu[1]
    # K (H Σ) = K (Σ Hᵀ)ᵀ
    after = xx - (k00 * s00 + k01 * s01), xy - (k00 * s10 + k01 * s11), yy - (k10 * s10 + k11 * s11)
    return moved, after
