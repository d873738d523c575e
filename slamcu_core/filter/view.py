"""What the sensor should see of the rows within reach: the first half of section 4.3.1.

Existence asks of every row how likely it was in view; association asks where detections of it should have been. Both
answers average over the particles, but for most rows the mean pose knows them: far from every detection and from the
rim of the field of view, no particle can change them. Only the other rows are looked at by every particle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Occluder
from slamcu_core.filter import ekf
from slamcu_core.filter.association import Marginal, marginalise
from slamcu_core.filter.calibration import SensorCalibration
from slamcu_core.filter.detections import Seen
from slamcu_core.filter.particles import Cloud, Particles
from slamcu_core.filter.scratch import Scratch
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.geometry import rotation, wrap_in_place
from slamcu_core.models import SensorModel, Sight, occlusion_probability, shadow_angle, visibility_probability

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_MANY = 10_000  # rows of the map by particles: with fewer, to choose costs more than to look at all
_MARGIN = 2.0  # times the gate, on squares: a row is given up only if it is so far beyond by the mean pose
_BENT = 6.0  # standard deviations of the place: nearer than this the mean pose is no guide to what particles see
_TAIL_STD, _TAIL_RAD, _TAIL_M = 25.0, 0.005, 20.0  # so far beside an edge or before it, a shadow is whole or none
_POSITION_STD = 0.01  # rad, of the bearings that a position sensor implies


class View(NamedTuple):
    """What one sensor should see at one instant of F rows, the first C of them looked at by every particle.

    Of those C, the map's come first, then the car's own finds. `visible` (F,) is P(visible) by field of view, `hidden`
    (F,) the probability of occlusion, `shown` (F,) that neither keeps it from sight. `marginal` is of the C; of its
    variances `by_place` (2, C) comes from where the feature may be, `by_motion` (2, C) from the poses' pending noise.
    """

    rows: Index
    close: int  # C
    mapped: int  # how many of the C are the map's
    visible: Array
    hidden: Array
    shown: Array
    marginal: Marginal
    by_place: Array
    by_motion: Array
    distance: Array  # (F,) m, from the mean pose


class _Outline(NamedTuple):
    """F rows as the mean pose sees them, map rows first, in the axes of a sensor there."""

    rows: Index
    mapped: int
    place: Array  # (2, F) m
    distance: Array  # (F,) m
    bearing: Array  # (F,) rad within ±π
    axes: Array  # (2, 2) turns the map's frame into these axes
    origin: Array  # (2,) m, what must then be subtracted


class Lookout:
    """A sensor's view of the rows of a table from a cloud of particles."""

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
        self._scratch = Scratch()
        self._around: Index | None = None  # the rows last given ...
        self._fitting = np.zeros(0, dtype=np.intp)  # ... and those of them of classes that the sensor detects
        self._mapped = 0  # of which so many are the map's

    def look(self, around: Index, cloud: Cloud, seen: Seen, occluders: tuple[Occluder, ...]) -> View | None:
        """Predict what the sensor should see of the active rows, which have the car's own finds last.

        None if nothing is within reach and nothing was seen.
        """
        outline = self._within_reach(around, cloud.mean)
        count = len(outline.rows)
        if not count and not len(seen.weight):
            return None
        weights, pending = cloud.weights, self._particles.pending_covariance(cloud.weights)
        covariance = (cloud.delta * weights) @ cloud.delta.T
        covariance += pending
        inside = None
        if outline.mapped * len(weights) > _MANY:
            outline, close, inside = self._put_close_ones_first(outline, cloud, covariance, seen, occluders)
        else:
            close = count
        rows, mapped = outline.rows, outline.mapped

        memory = self._scratch.array(6, close, len(weights))
        place = outline.place[:, :close]
        finds = rows[mapped:close]
        sight = self._by_every_particle(outline, finds, place, cloud=cloud, covariance=covariance, memory=memory)
        visible = visibility_probability(self._model.sensor, sight.distance, sight.bearing, weights)
        if inside is not None:
            visible = np.concatenate([visible, inside])
        mean_distance = sight.distance @ weights
        extra, by_place, by_motion = self._variances(outline, rows[:close], mapped, place, pending=pending, cloud=cloud)
        extra[0] += mean_distance * mean_distance * self._calibration.variance[0]
        extra[2] += self._calibration.variance[1]
        predicted = self._calibrated(sight, out=memory[4:])
        marginal = marginalise(predicted, weights, extra, scratch=memory[:2])

        hidden, shown = np.zeros(count), visible
        if occluders:
            distance, bearing = outline.distance.copy(), outline.bearing
            distance[:close] = mean_distance
            std = np.full(count, _POSITION_STD)
            if self._model.has_bearing:
                std[close:] = self._bearing_std(rows[close:], distance[close:], covariance)
                std[:close] = np.sqrt(marginal.covariance[2])
            bearing[mapped:close] = np.arctan2(place[1, mapped:], place[0, mapped:])
            hidden = occlusion_probability(occluders, distance, bearing, std)
            shown = visible * (1.0 - hidden)
        return View(rows, close, mapped, visible, hidden, shown, marginal, by_place, by_motion, outline.distance)

    def _within_reach(self, around: Index, mean: Array) -> _Outline:
        """Look from the mean pose (3,) and keep what the sensor could see from near there."""
        table, model = self._table, self._model
        if around is not self._around:
            self._around = around
            self._fitting = around[(table.feature_class[around, None] == self._codes).any(axis=1)]
            self._mapped = int(np.count_nonzero(table.kind[self._fitting] != Kind.NEW))
        place, direction = model.origin(mean)
        axes = rotation(-float(direction))
        origin = axes @ place
        ahead = axes @ table.xy.T.take(self._fitting, axis=1)
        ahead -= origin[:, None]
        squares = ahead * ahead
        distance = np.sqrt(squares[0] + squares[1])
        bearing = np.arctan2(ahead[1], ahead[0])
        within = np.abs(bearing) < model.half_angle + 0.2
        within |= distance < 5.0
        within &= distance < model.sensor.max_range_m + 10.0
        kept = within.nonzero()[0]
        mapped = int(np.count_nonzero(within[: self._mapped]))
        return _Outline(
            self._fitting[kept],
            mapped,
            ahead.take(kept, axis=1),
            distance[kept],
            bearing[kept],
            axes,
            origin,
        )

    def _put_close_ones_first(
        self, outline: _Outline, cloud: Cloud, covariance: Array, seen: Seen, occluders: tuple[Occluder, ...]
    ) -> tuple[_Outline, int, Array]:
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
        self, outline: _Outline, cloud: Cloud, covariance: Array, seen: Seen, occluders: tuple[Occluder, ...]
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
        near |= distance < _BENT * _place_std(covariance)
        near |= self._fit(outline, cloud, covariance, seen)
        if occluders:
            std = self._bearing_std(outline.rows[:mapped], distance, covariance)
            near |= _at_an_edge(occluders, distance, bearing, std)
        return inside, near

    def _fit(self, outline: _Outline, cloud: Cloud, covariance: Array, seen: Seen) -> NDArray[np.bool_] | bool:
        """Return which of the map's rows a detection could belong to, by a wider gate than that of association."""
        if not self._model.has_bearing:
            return True
        if not len(seen.weight):
            return False
        distance, bearing = outline.distance[: outline.mapped], outline.bearing[: outline.mapped]
        calibration = self._particles.calibration
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

    def _bearing_std(self, rows: Index, distance: Array, covariance: Array) -> Array:
        """Return how well bearings (F,) are known at least."""
        place = 2.0 * self._place_variance(rows, covariance) / np.maximum(distance * distance, 1e-6)
        return np.asarray(np.sqrt(place + (2.0 * float(covariance[2, 2]) + self._calibration.variance[1])))

    def _by_every_particle(
        self, outline: _Outline, finds: Index, place: Array, *, cloud: Cloud, covariance: Array, memory: Array
    ) -> Sight:
        """Return how every particle sees places (2, C), the finds among them where each particle has them.

        In the axes of the mean sensor no bearing need be wrapped. Sets the finds' places to their means.
        """
        particles, model, mapped = self._particles, self._model, place.shape[1] - len(finds)
        sensors, _ = model.origin(particles.pose)
        sensors = outline.axes @ sensors
        sensors -= outline.origin[:, None]
        own = outline.axes @ particles.means.take(self._table.slot[finds], axis=1).reshape(2, -1)
        own -= outline.origin[:, None]
        own = own.reshape(2, len(finds), len(particles))
        place[:, mapped:] = own @ cloud.weights
        delta = memory[:2]
        np.subtract(place[:, :mapped, None], sensors[:, None], out=delta[:, :mapped])
        np.subtract(own, sensors[:, None], out=delta[:, mapped:])
        pose = cloud.delta
        if not model.has_bearing:
            pose = pose - np.deg2rad([[0.0], [0.0], [model.sensor.mount.yaw_deg]])
        sight = model.sight_along(pose, delta, cloud.delta[2], out=memory[2:4])
        # unless they stand behind, or so near that some particle may see them there
        if place.shape[1] and float(place[0].min()) < _BENT * _place_std(covariance):
            off, bearing = sight.bearing, np.arctan2(place[1], place[0])[:, None]
            off -= bearing
            wrap_in_place(off)
            off += bearing
        return sight

    def _variances(
        self, outline: _Outline, rows: Index, mapped: int, place: Array, *, pending: Array, cloud: Cloud
    ) -> tuple[Array, Array, Array]:
        """Return covariances (3, C) of measurements, and the variances (2, C) in them by place and by pending noise.

        That is H Σ Hᵀ where the mean pose sees the mean place.
        """
        table, particles, model = self._table, self._particles, self._model
        spread = table.covariance.T.take(rows, axis=1)
        spread[:, mapped:] = particles.covariances.take(table.slot[rows[mapped:]], axis=1) @ cloud.weights
        squares = place * place
        centre = Sight(outline.axes.T @ place, np.sqrt(squares[0] + squares[1]), place[1], None, cloud.mean[:, None])
        if not model.has_bearing:
            centre = model.sight(cloud.mean[:, None], centre.delta + model.origin(cloud.mean)[0][:, None])
        by_feature = model.by_feature(centre)
        by_place = ekf.projected(by_feature, spread)
        by_pose = model.by_pose(centre, by_feature)
        by_motion = np.add.reduce(by_pose[:, None] * np.matmul(pending, by_pose), axis=2)
        extra = by_place.copy()
        extra[:2] += by_motion[0]
        extra[2] += by_motion[1, 1]
        return extra, by_place[::2], by_motion[[0, 1], [0, 1]]

    def _calibrated(self, sight: Sight, out: Array) -> Array:
        """Return measurements (2, C, M) as each particle's calibration makes the sensor show them."""
        scale, turn = self._particles.calibration
        if not self._model.has_bearing:
            return np.asarray(np.multiply(sight.measurement, 1.0 + scale, out=out))
        np.multiply(sight.distance, 1.0 + scale, out=out[0])
        np.add(sight.bearing, turn, out=out[1])
        return out


def _place_std(covariance: Array) -> float:
    """Return the standard deviation (m) of a pose's place in all, from its covariance (3, 3)."""
    return math.sqrt(covariance[0, 0] + covariance[1, 1])


def _at_an_edge(
    occluders: tuple[Occluder, ...], distance: Array, bearing: Array, bearing_std: Array
) -> NDArray[np.bool_]:
    """Return which rows stand so near the edge of a shadow that it matters how well their bearing is known."""
    found = np.zeros(len(distance), dtype=bool)
    for occluder in occluders:
        edge = np.abs(np.abs(bearing - occluder.bearing) - shadow_angle(occluder))
        found |= (edge < _TAIL_STD * bearing_std + _TAIL_RAD) & (distance > occluder.range - _TAIL_M)
    return found
