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


def along_road(axis: Array, vectors: Array) -> Array:
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
    enough = table.hits[rows] >= parameters.minimum_hits
    slowest = max(parameters.mover_speed, _SLOWEST_MOVER * abs(own_speed))
    scale_variance = (_SCALE_ERROR * own_speed) ** 2
    # one by one in plain numbers: of the few finds that are asked of, most fail early
    for index in enough.nonzero()[0].tolist():
        xx, xy, yy, xx_t, xy_t, xx_tt, x, y, x_t = table.track[rows[index]].tolist()
        determinant = xx * yy - xy * xy
        enough[index] = False
        if not determinant > 0.0:
            continue
        along, across = (yy * xx_t - xy * xy_t) / determinant, (xx * xy_t - xy * xx_t) / determinant
        information = xx_tt - along * xx_t - across * xy_t  # about the speed, the place being free
        if not information > _ROUNDING * xx_tt:
            continue
        speed = abs((x_t - along * x - across * y) / information)
        variance = 1.0 / information + scale_variance
        faster = max(slowest - speed, 0.0)
        enough[index] = speed * speed < 9.0 * variance and faster * faster - speed * speed > 4.6 * variance
    return np.asarray(enough)
