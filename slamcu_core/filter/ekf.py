"""The EKF of new features in each particle, eq. 13-16 with the errata, on arrays of 2×2 matrices.

Components lead: vectors are (2, ...), matrices (2, 2, ...), as many of them as there are features and particles. So a
product of matrices is three operations on long arrays instead of a call for each small matrix.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def product(a: Array, b: Array) -> Array:
    """Return the matrix products a b: (I, J, ...) by (J, K, ...) gives (I, K, ...)."""
    total = a[:, 0, None] * b[0]
    for inner in range(1, len(b)):
        total += a[:, inner, None] * b[inner]
    return np.asarray(total)


def apply(matrix: Array, vector: Array) -> Array:
    """Return the products (I, ...) of matrices (I, J, ...) and vectors (J, ...)."""
    total = matrix[:, 0] * vector[0]
    for inner in range(1, len(vector)):
        total += matrix[:, inner] * vector[inner]
    return np.asarray(total)


def transpose(matrix: Array) -> Array:
    """Return matrices (J, I, ...) of matrices (I, J, ...)."""
    return matrix.swapaxes(0, 1)


def determinant_2x2(matrix: Array) -> Array:
    """Return the determinants (...) of matrices (2, 2, ...)."""
    return np.asarray(matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0])


def inverse_2x2(matrix: Array) -> tuple[Array, Array]:
    """Return the inverses (2, 2, ...) and determinants (...) of matrices (2, 2, ...)."""
    determinant = determinant_2x2(matrix)
    inverse = np.empty_like(matrix)
    np.divide(matrix[1, 1], determinant, out=inverse[0, 0, ...])
    np.divide(matrix[0, 0], determinant, out=inverse[1, 1, ...])
    np.divide(matrix[0, 1], -determinant, out=inverse[0, 1, ...])
    np.divide(matrix[1, 0], -determinant, out=inverse[1, 0, ...])
    return inverse, determinant


def mahalanobis_square(vector: Array, covariance: Array) -> tuple[Array, Array]:
    """Return νᵀ Q⁻¹ ν for vectors (2, ...) and symmetric matrices (2, 2, ...), and the determinants of Q."""
    x, y = vector
    determinant = determinant_2x2(covariance)
    square = x * x * covariance[1, 1] - (2.0 * x) * y * covariance[0, 1] + y * y * covariance[0, 0]
    return square / determinant, determinant


def innovation_covariance(jacobian: Array, covariance: Array, noise: Array) -> Array:
    """Return Q = H Σ Hᵀ + R (eq. 18); `noise` holds the variances (2, ...) of R."""
    q = product(product(jacobian, covariance), transpose(jacobian))
    q[0, 0] += noise[0]
    q[1, 1] += noise[1]
    return q


def update(mean: Array, covariance: Array, jacobian: Array, innovation: Array, noise: Array) -> tuple[Array, Array]:
    """Return mean and covariance after a measurement (eq. 16), all shapes (2, ...) and (2, 2, ...).

    K = Σ Hᵀ (H Σ Hᵀ + R)⁻¹, μ ← μ + K (z - ẑ), Σ ← (I - K H) Σ in Joseph's form, which stays positive definite.
    """
    across = product(covariance, transpose(jacobian))
    q = product(jacobian, across)
    q[0, 0] += noise[0]
    q[1, 1] += noise[1]
    gain = product(across, inverse_2x2(q)[0])
    moved = mean + apply(gain, innovation)
    rest = -product(gain, jacobian)
    rest[0, 0] += 1.0
    rest[1, 1] += 1.0
    spread = product(product(rest, covariance), transpose(rest)) + product(gain * noise, transpose(gain))
    return moved, spread


def birth_covariance(jacobian: Array, noise: Array) -> Array:
    """Return Σ = H⁻¹ R H⁻ᵀ of a feature placed by one measurement, shape (2, 2, ...)."""
    back, _ = inverse_2x2(jacobian)
    return product(back * noise, transpose(back))
