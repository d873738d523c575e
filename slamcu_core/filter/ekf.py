"""The EKF of new features in each particle, eq. 13-16 with the errata, in closed form on arrays.

Components lead: vectors are (2, ...), symmetric matrices (3, ...) of xx, xy, yy, general ones (2, 2, ...), as many of
them as there are features and particles. H is a rotation into the line of sight (`models.Jacobian`), in whose axes the
noise R is diagonal, and all inverses are written out: a step is a few operations on long arrays, not a call for each
small matrix.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slamcu_core.models import Jacobian

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


def full(matrix: Sequence[Array] | Array) -> Array:
    """Return symmetric matrices (3, ...) as (2, 2, ...)."""
    xx, xy, yy = matrix
    return np.array([[xx, xy], [xy, yy]])


def turned(cos: Array, sin: Array, matrix: Sequence[Array] | Array) -> Array:
    """Return R Σ Rᵀ (3, ...) of symmetric matrices (3, ...) with R = [[cos, sin], [-sin, cos]]."""
    xx, xy, yy = matrix[0], matrix[1], matrix[2]
    first = xx * cos
    first += xy * sin
    second = xy * cos
    second += yy * sin
    result = np.empty((3, *first.shape))
    along, across = result[0, ...], result[1, ...]
    np.multiply(first, cos, out=along)
    np.multiply(second, cos, out=across)
    second *= sin
    along += second
    first *= sin
    across -= first
    np.subtract(xx + yy, along, out=result[2, ...])
    return result


def projected(jacobian: Jacobian, covariance: Sequence[Array] | Array) -> Array:
    """Return H Σ Hᵀ (3, ...) of covariances Σ (3, ...)."""
    return shrunk(jacobian, turned(jacobian.cos, jacobian.sin, covariance))


def shrunk(jacobian: Jacobian, along: Array) -> Array:
    """Turn covariances (3, ...) along the line of sight, R Σ Rᵀ, into those of what is measured there, in place."""
    along[1:] *= jacobian.shrink
    along[2] *= jacobian.shrink
    return along


def update(mean: Array, by_place: Array, jacobian: Jacobian, innovation: Array, noise: Array) -> tuple[Array, Array]:
    """Return mean (2, ...) and covariance (3, ...) after a measurement (eq. 16); `by_place` (3, ...) is P = H Σ Hᵀ.

    K = Σ Hᵀ (P + R)⁻¹, μ ← μ + K (z - ẑ), Σ ← (I - K H) Σ, worked out in the axes of the measurement, where R is
    diagonal: there P ← R - R (P + R)⁻¹ R, in which only what is positive is added.
    """
    p00, p01, p11 = by_place[0], by_place[1], by_place[2]
    n0, n1 = noise[0], noise[1]
    first, second = p00 * n1, p11 * n0
    determinant = p00 * p11
    determinant -= p01 * p01
    first += determinant
    second += determinant
    determinant = p11 + n1
    determinant *= n0
    determinant += first
    first /= determinant
    second /= determinant
    cross = p01 / determinant
    along, across = innovation[0], innovation[1]
    stretch = 1.0 / jacobian.shrink
    u = first * along
    u += (cross * n0) * across
    cross *= n1
    v = cross * along
    v += second * across
    v *= stretch
    cross *= n0
    cross *= stretch
    first *= n0
    second *= n1
    second *= stretch * stretch
    cos, sin = jacobian.cos, jacobian.sin
    moved = np.empty(mean.shape)
    np.add(mean[0], cos * u - sin * v, out=moved[0, ...])
    np.add(mean[1], sin * u + cos * v, out=moved[1, ...])
    return moved, turned(cos, -sin, (first, cross, second))


def birth_covariance(jacobian: Jacobian, noise: Array) -> Array:
    """Return Σ = H⁻¹ R H⁻ᵀ (3, ...) of a feature placed by one measurement."""
    along, across = noise[0], noise[1] / (jacobian.shrink * jacobian.shrink)
    return turned(jacobian.cos, -jacobian.sin, (along, np.zeros(across.shape), across))
