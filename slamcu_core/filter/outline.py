"""What the mean pose sees, and of which rows no particle could see anything else: what a view begins with.

Far from every detection, from the rim of the field of view and from the edge of every shadow, the mean pose knows what
all particles see. Bounds are wide: a row that is left out could not have mattered.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Occluder
from slamcu_core.filter.calibration import SensorCalibration
from slamcu_core.filter.detections import Seen
from slamcu_core.filter.particles import Cloud, Particles
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.geometry import rotation, wrap_angle, wrap_in_place
from slamcu_core.models import SensorModel, shadow_angle

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_BESIDE_RAD = 0.2  # so far beside the field of view of the mean pose, no particle sees anything
_MARGIN = 2.0  # times the gate, on squares: a row is given up only if it is so far beyond by the mean pose
_BENT = 6.0  # standard deviations of the place: nearer than this the mean pose is no guide to what particles see
_TAIL_STD, _TAIL_RAD, _TAIL_M = 25.0, 0.005, 20.0  # so far beside an edge or before it, a shadow is whole or none


class Outline(NamedTuple):
    """F rows as the mean pose sees them, map rows first, in the axes of a sensor there."""

    rows: Index
    mapped: int
    place: Array  # (2, F) m
    distance: Array  # (F,) m
    bearing: Array  # (F,) rad within ±π
    axes: Array  # (2, 2) turns the map's frame into these axes
    origin: Array  # (2,) m, what must then be subtracted


class MeanLook:
    """A sensor's view of the rows of a table from the mean pose."""

    def __init__(
        self,
        model: SensorModel,
        table: FeatureTable,
        particles: Particles,
        calibration: SensorCalibration,
        *,
        codes: Index,
        gate: float,
    ) -> None:
        self._model, self._table, self._particles, self._calibration = model, table, particles, calibration
        self._codes = codes  # of the classes that the sensor detects
        self._gate = gate
        widest = model.half_angle + _BESIDE_RAD
        self._least_cosine = math.cos(widest) if widest < math.pi else -2.0
        self._around: Index | None = None  # the rows last given ...
        self._fitting = np.zeros(0, dtype=np.intp)  # ... and those of them of classes that the sensor detects
        self._mapped = 0  # of which so many are the map's

    def within_reach(self, around: Index, mean: Array) -> Outline:
        """Look from the mean pose (3,) and keep what the sensor could see from near there."""
        table, model = self._table, self._model
        if around is not self._around:
            self._around = around
            self._fitting = around[(table.feature_class[around, None] == self._codes).any(axis=1)]
            self._mapped = int(np.count_nonzero(table.kind[self._fitting] != Kind.NEW))
        place, direction = model.origin(mean)
        axes = rotation(-float(direction))
        origin = axes @ place
        ahead = axes @ table.xy.take(self._fitting, axis=0).T
        ahead -= origin[:, None]
        squares = ahead * ahead
        distance = np.sqrt(squares[0] + squares[1])
        within = ahead[0] > self._least_cosine * distance
        within |= distance < 5.0
        within &= distance < model.sensor.max_range_m + 10.0
        kept = within.nonzero()[0]
        mapped = int(kept.searchsorted(self._mapped))
        ahead = ahead.take(kept, axis=1)
        bearing = np.arctan2(ahead[1], ahead[0])
        return Outline(self._fitting[kept], mapped, ahead, distance[kept], bearing, axes, origin)

    def close_ones_first(
        self, outline: Outline, cloud: Cloud, covariance: Array, seen: Seen, occluders: tuple[Occluder, ...]
    ) -> tuple[Outline, int, Array]:
        """Sort rows into those that every particle must look at, of the map and found, and the map's others.

        Return how many are to be looked at, and P(visible) of the others.
        """
        inside, near = self._by_the_mean(outline, cloud, covariance, seen, occluders)
        chosen, others = near.nonzero()[0], (~near).nonzero()[0]
        finds = np.arange(outline.mapped, len(outline.rows))
        order = np.concatenate([chosen, finds, others])
        sorted_outline = outline._replace(
            rows=outline.rows[order],
            mapped=len(chosen),
            place=outline.place.take(order, axis=1),
            distance=outline.distance[order],
            bearing=outline.bearing[order],
        )
        return sorted_outline, len(chosen) + len(finds), inside[others].astype(float)

    def _by_the_mean(
        self, outline: Outline, cloud: Cloud, covariance: Array, seen: Seen, occluders: tuple[Occluder, ...]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return of the map's rows which are in the field of view, and which need the look of every particle.

        `covariance` (3, 3) is that of the poses, the pending noise included.
        """
        mapped, sensor, half = outline.mapped, self._model.sensor, self._model.half_angle
        distance, bearing = outline.distance[:mapped], outline.bearing[:mapped]
        aside = np.abs(bearing)
        # no particle is further from the mean than this, nor sees a thing in a direction that differs by more
        x, y, turn = cloud.delta
        swing = float(np.maximum.reduce(np.abs(turn)))
        radius = math.sqrt(np.maximum.reduce(x * x + y * y)) + swing * math.hypot(sensor.mount.x, sensor.mount.y)
        bent = (0.5 * math.pi * radius) / np.maximum(distance, 1e-3)
        bent += swing
        inside = aside + bent <= half
        inside &= distance >= sensor.min_range_m + radius
        inside &= distance <= sensor.max_range_m - radius
        near = aside - bent <= half
        near &= distance >= sensor.min_range_m - radius
        near &= distance <= sensor.max_range_m + radius
        near &= ~inside
        near |= distance < _bent_within(covariance)
        near |= self._fit(outline, cloud, covariance, seen)
        if occluders:
            std = self.bearing_std(outline.rows[:mapped], distance, covariance)
            near |= _at_an_edge(occluders, distance, bearing, std)
        return inside, near

    def _fit(self, outline: Outline, cloud: Cloud, covariance: Array, seen: Seen) -> NDArray[np.bool_] | bool:
        """Return which of the map's rows a detection could belong to, by a wider gate than that of association."""
        if not self._model.has_bearing:
            return True
        if not len(seen.weight):
            return False
        distance, bearing = outline.distance[: outline.mapped], outline.bearing[: outline.mapped]
        calibration = self._calibration.means(self._particles)
        scale, turn = (calibration @ cloud.weights).tolist()
        spread, common = ((calibration * calibration) @ cloud.weights).tolist(), self._calibration.variance.tolist()
        noise = np.maximum.reduce(seen.noise, axis=1).tolist()
        # variances of place and motion at most: the trace where no direction is asked for, twice for what correlates
        place = self._place_variance(outline.rows[: outline.mapped], covariance)
        farthest = (self._model.sensor.max_range_m + 10.0) ** 2
        slack = place + (farthest * (spread[0] - scale * scale + common[0]) + noise[0])
        off = np.abs(seen.measurement[0, :, None] - distance * (1.0 + scale))
        fit = off < np.sqrt((_MARGIN * self._gate) * slack)
        place *= 2.0
        place /= distance * distance
        place += 2.0 * float(covariance[2, 2]) + spread[1] - turn * turn + common[1] + noise[1]
        off = seen.measurement[1, :, None] - (bearing + turn)
        wrap_in_place(off)
        np.abs(off, out=off)
        fit &= off < np.sqrt((_MARGIN * self._gate) * place)
        return np.asarray(fit.any(axis=0))

    def _place_variance(self, rows: Index, covariance: Array) -> Array:
        """Return the variance (F,) that the map's and the poses' places have at most, seen from each other (m²)."""
        place = self._table.covariance.T.take(rows, axis=1)
        return np.asarray(place[0] + place[2] + 2.0 * _place_std(covariance) ** 2)

    def bearing_std(self, rows: Index, distance: Array, covariance: Array) -> Array:
        """Return how well bearings (F,) are known at least."""
        place = 2.0 * self._place_variance(rows, covariance) / np.maximum(distance * distance, 1e-6)
        return np.asarray(np.sqrt(place + (2.0 * float(covariance[2, 2]) + self._calibration.variance[1])))


def _place_std(covariance: Array) -> float:
    """Return the standard deviation (m) of a pose's place in all, from its covariance (3, 3)."""
    return math.sqrt(covariance[0, 0] + covariance[1, 1])


def _bent_within(covariance: Array) -> float:
    """Return the distance (m) within which particles see a thing too differently for the mean pose to be a guide."""
    return _BENT * _place_std(covariance)


def _at_an_edge(
    occluders: tuple[Occluder, ...], distance: Array, bearing: Array, bearing_std: Array
) -> NDArray[np.bool_]:
    """Return which rows stand so near the edge of a shadow that it matters how well their bearing is known."""
    found = np.zeros(len(distance), dtype=bool)
    for occluder in occluders:
        edge = np.abs(np.abs(wrap_angle(bearing - occluder.bearing)) - shadow_angle(occluder))
        found |= (edge < _TAIL_STD * bearing_std + _TAIL_RAD) & (distance > occluder.range - _TAIL_M)
    return found
