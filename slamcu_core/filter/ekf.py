"""The EKF of new features in each particle, eq. 13-16 with the errata, on arrays of 2×2 matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def inverse_2x2(matrix: Array) -> tuple[Array, Array]:
    """Return the inverses (..., 2, 2) and determinants (...) of symmetric positive definite matrices."""
    determinant = matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]
    inverse = np.empty_like(matrix)
    inverse[..., 0, 0], inverse[..., 1, 1] = matrix[..., 1, 1], matrix[..., 0, 0]
    inverse[..., 0, 1], inverse[..., 1, 0] = -matrix[..., 0, 1], -matrix[..., 1, 0]
    return inverse / determinant[..., None, None], determinant


def innovation_covariance(jacobian: Array, covariance: Array, noise: Array) -> Array:
    """Return Q = H Σ Hᵀ + R (eq. 18); `noise` holds the variances (..., 2) of R."""
    q = jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)
    q[..., 0, 0] += noise[..., 0]
    q[..., 1, 1] += noise[..., 1]
    return q


def update(mean: Array, covariance: Array, jacobian: Array, innovation: Array, noise: Array) -> tuple[Array, Array]:
    """Return mean and covariance after a measurement (eq. 16), all shapes (..., 2) and (..., 2, 2).

    K = Σ Hᵀ (H Σ Hᵀ + R)⁻¹, μ ← μ + K (z - ẑ), Σ ← (I - K H) Σ in Joseph's form, which stays positive definite.
    """
    inverse, _ = inverse_2x2(innovation_covariance(jacobian, covariance, noise))
    gain = covariance @ np.swapaxes(jacobian, -1, -2) @ inverse
    moved = mean + (gain @ innovation[..., None])[..., 0]
    rest = np.eye(2) - gain @ jacobian
    spread = rest @ covariance @ np.swapaxes(rest, -1, -2) + (gain * noise[..., None, :]) @ np.swapaxes(gain, -1, -2)
    return moved, spread


def birth_covariance(jacobian: Array, noise: Array) -> Array:
    """Return Σ = H⁻¹ R H⁻ᵀ of a feature placed by one measurement, shape (..., 2, 2)."""
    back = np.linalg.inv(jacobian)
    return np.asarray((back * noise[..., None, :]) @ np.swapaxes(back, -1, -2))
