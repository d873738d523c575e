"""Symmetric 2×2 matrices in closed form: components lead, (3, ...) of xx, xy, yy; vectors are (2, ...).

Components are taken by their numbers: to unpack an array takes as long as an operation on it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def inverse(matrix: Sequence[Array] | Array) -> Array:
    """Return the inverses (3, ...) of symmetric matrices (3, ...)."""
    xx, xy, yy = matrix
    return np.asarray(np.array([yy, -xy, xx]) / (xx * yy - xy * xy))


def times(matrix: Array, vector: Array) -> Array:
    """Return the products (2, ...) of symmetric matrices (3, ...) and vectors (2, ...)."""
    xx, xy, yy = matrix
    x, y = vector
    return np.array([xx * x + xy * y, xy * x + yy * y])


def mahalanobis_square(vector: Array, covariance: Sequence[Array] | Array) -> tuple[Array, Array]:
    """Return νᵀ Q⁻¹ ν for vectors (2, ...) and symmetric matrices (3, ...), and the determinants of Q."""
    x, y = vector[0], vector[1]
    xx, xy, yy = covariance[0], covariance[1], covariance[2]
    determinant = xx * yy
    determinant -= xy * xy
    square = x * x
    square *= yy
    cross = x * y
    cross *= xy
    cross += cross
    square -= cross
    across = y * y
    across *= xx
    square += across
    square /= determinant
    return square, determinant
