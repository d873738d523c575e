"""Does a find stand still? Signs painted on lorries look like signs, until their motion tells.

Each find keeps a weighted regression of its place, and of a speed along the road, on all its ranges and bearings. How
fast the bearing of a thing beside the road changes tells its speed as well as its ranges do, or better.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.table import FeatureTable

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_SCALE_ERROR = 0.06  # of our own speed; how fast a still sign may seem to move for errors of range
_SLOWEST_MOVER = 0.5  # of our own speed; what moves along with traffic moves at least so fast
_ROUNDING = 1e-9  # of sums


def along(axis: Array, vectors: Array) -> Array:
    """Return vectors (2, A) of dead reckoning's frame along roads of directions `axis` (2, A), and to their left."""
    cos, sin = axis
    x, y = vectors
    return np.array([cos * x + sin * y, cos * y - sin * x])


def track(table: FeatureTable, rows: Index, offset: Array, information: tuple[Array, Array, Array], t: float) -> None:
    """Add sightings of rows (A,) at a time to their regressions.

    `offset` (2, A) leads there from our place at the birth of the rows, `information` is R⁻¹ of that as xx, xy, yy,
    both in the axes of the road.
    """
    x, y = offset
    since = t - table.born[rows]
    xx, xy, yy = information
    sums = np.empty((9, len(rows)))  # of least squares: the matrix of place and speed, then its right-hand side
    sums[0], sums[1], sums[2] = information
    np.multiply(sums[:2], since, out=sums[3:5])
    np.multiply(sums[3], since, out=sums[5])
    np.add(xx * x, xy * y, out=sums[6])
    np.add(xy * x, yy * y, out=sums[7])
    np.multiply(sums[6], since, out=sums[8])
    table.track[rows] += sums.T


def stands_still(
    table: FeatureTable, rows: NDArray[np.intp], own_speed: float, parameters: FilterParameters
) -> NDArray[np.bool_]:
    """Return whether rows have proven to stand still.

    A row is proven when its speed agrees with 0 (chi-square 9) and is ten times as likely to be that as the slowest
    mover's. A wrong scale of range looks like a speed in proportion to our own.
    """
    xx, xy, yy, xx_t, xy_t, xx_tt, x, y, x_t = table.track.take(rows, axis=0).T
    determinant = xx * yy - xy * xy
    known = (determinant > 0.0) & (table.hits[rows] >= parameters.minimum_hits)
    if not np.count_nonzero(known):
        return np.asarray(known)
    determinant[~known] = 1.0
    along, across = (yy * xx_t - xy * xy_t) / determinant, (xx * xy_t - xy * xx_t) / determinant
    information = xx_tt - along * xx_t - across * xy_t  # about the speed, the place being free
    known &= information > _ROUNDING * xx_tt
    information[~known] = 1.0
    speed = (x_t - along * x - across * y) / information
    np.abs(speed, out=speed)
    variance = 1.0 / information
    variance += (_SCALE_ERROR * own_speed) ** 2
    faster = np.maximum(max(parameters.mover_speed, _SLOWEST_MOVER * abs(own_speed)) - speed, 0.0)
    speed *= speed
    known &= speed < 9.0 * variance
    faster *= faster
    faster -= speed
    known &= faster > 4.6 * variance
    return np.asarray(known)
