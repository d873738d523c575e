"""Does a find stand still? Signs painted on lorries look like signs, until their motion tells.

Each find keeps a weighted regression of its place, and of a speed along the road, on all its ranges and bearings. How
fast the bearing of a thing beside the road changes tells its speed as well as its ranges do, or better.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.table import FeatureTable
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_SCALE_ERROR = 0.06  # of our own speed; how fast a still sign may seem to move for errors of range
_SLOWEST_MOVER = 0.5  # of our own speed; what moves along with traffic moves at least so fast
_ROUNDING = 1e-9  # of sums


def track(
    table: FeatureTable, rows: Index, model: SensorModel, sightings: Iterable[tuple[float, ...]], t: float
) -> None:
    """Add sightings of rows (A,) at a time to their regressions, each in the axes of the road at its birth.

    Of each: its place and direction in dead reckoning's frame, the first component of what was measured, and the
    variances of both.
    """
    sums = []  # of least squares: the matrix of place and speed, then its right-hand side
    axes, origins, born = table.axis.take(rows, axis=0), table.origin.take(rows, axis=0), table.born[rows]
    for (cos, sin), (x0, y0), start, (place_x, place_y, to_x, to_y, *measured) in zip(
        axes.tolist(), origins.tolist(), born.tolist(), sightings, strict=True
    ):
        east, north = place_x - x0, place_y - y0
        x, y = cos * east + sin * north, cos * north - sin * east
        xx, xy, yy = model.information(cos * to_x + sin * to_y, cos * to_y - sin * to_x, *measured)
        since = t - start
        xx_t, xy_t, right = xx * since, xy * since, xx * x + xy * y
        sums.append([xx, xy, yy, xx_t, xy_t, xx_t * since, right, xy * x + yy * y, right * since])
    table.track[rows] += sums


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
    asked = enough.nonzero()[0]
    tracks = table.track.take(rows[asked], axis=0).tolist()
    for index, (xx, xy, yy, xx_t, xy_t, xx_tt, x, y, x_t) in zip(asked.tolist(), tracks, strict=True):
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
