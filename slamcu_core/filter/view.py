"""What the sensor should see of the rows within reach: the first half of section 4.3.1.

Existence asks of every row how likely it was in view; association asks where detections of it should have been. Both
answers average over the particles, but for most rows the mean pose knows them: far from every detection and from the
rim of the field of view, no particle can change them. Only the other rows are looked at by every particle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Occluder
from slamcu_core.filter import ekf
from slamcu_core.filter.association import Marginal, marginalise
from slamcu_core.filter.calibration import SensorCalibration
from slamcu_core.filter.detections import Seen
from slamcu_core.filter.outline import MeanLook, Outline
from slamcu_core.filter.particles import Cloud, Particles
from slamcu_core.filter.scratch import Scratch
from slamcu_core.filter.table import FeatureTable
from slamcu_core.geometry import wrap_in_place
from slamcu_core.models import SensorModel, Sight, occlusion_probability, visibility_probability

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_MANY = 10_000  # rows of the map by particles: with fewer, to choose costs more than to look at all
_POSITION_STD = 0.01  # rad, of the bearings that a position sensor implies


class View(NamedTuple):
    """What one sensor should see at one instant of F rows, the first C of them looked at by every particle.

    Of those C, the map's come first, then the car's own finds. `visible` (F,) is P(visible) by field of view, `hidden`
    (F,) the probability of occlusion, `shown` (F,) that neither keeps it from sight. `marginal` is of the C, `noise`
    (2, C) the variances of a measurement there; of the marginal's variances `by_place` (2, C) comes from where the
    feature may be, `by_motion` (2, C) from the poses' pending noise.
    """

    rows: Index
    close: int  # C
    mapped: int  # how many of the C are the map's
    visible: Array
    hidden: Array
    shown: Array
    marginal: Marginal
    noise: Array
    by_place: Array
    by_motion: Array
    distance: Array  # (F,) m, from the mean pose


class Lookout:
    """A sensor's view of the rows of a table from a cloud of particles."""

    def __init__(
        self,
        model: SensorModel,
        table: FeatureTable,
        particles: Particles,
        calibration: SensorCalibration,
        from_mean: MeanLook,
    ) -> None:
        self._model, self._table, self._particles, self._calibration = model, table, particles, calibration
        self._from_mean = from_mean
        self._scratch = Scratch()

    def look(self, around: Index, cloud: Cloud, seen: Seen, occluders: tuple[Occluder, ...]) -> View | None:
        """Predict what the sensor should see of the active rows, which have the car's own finds last.

        None if nothing is within reach and nothing was seen.
        """
        outline = self._from_mean.within_reach(around, cloud.mean)
        count = len(outline.rows)
        if not count and not len(seen.weight):
            return None
        weights, pending = cloud.weights, self._particles.pending_covariance(cloud.weights)
        inside = None
        if outline.mapped * len(weights) > _MANY:
            covariance = cloud.covariance + pending
            outline, close, inside = self._from_mean.close_ones_first(outline, cloud, covariance, seen, occluders)
        else:
            close = count
        rows, mapped = outline.rows, outline.mapped

        memory = self._scratch.array(6, close, len(weights))
        place = outline.place[:, :close]
        finds = rows[mapped:close]
        sight = self._by_every_particle(outline, finds, place, cloud=cloud, memory=memory)
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
                std[close:] = self._from_mean.bearing_std(rows[close:], distance[close:], cloud.covariance + pending)
                std[:close] = np.sqrt(marginal.covariance[2])
            bearing[mapped:close] = np.arctan2(place[1, mapped:], place[0, mapped:])
            hidden = occlusion_probability(occluders, distance, bearing, std)
            shown = visible * (1.0 - hidden)
        noise = self._model.noise(marginal.mean)
        return View(rows, close, mapped, visible, hidden, shown, marginal, noise, by_place, by_motion, outline.distance)

    def _by_every_particle(self, outline: Outline, finds: Index, place: Array, *, cloud: Cloud, memory: Array) -> Sight:
        """Return how every particle sees places (2, C), the finds among them where each particle has them.

        In the axes of the mean sensor. Sets the finds' places to their means.
        """
        particles, model, mapped = self._particles, self._model, place.shape[1] - len(finds)
        sensors = outline.axes @ model.origin(particles.pose)[0]
        own = outline.axes @ particles.means.take(self._table.slot[finds], axis=1).reshape(2, -1)
        own = own.reshape(2, len(finds), len(particles))
        place[:, mapped:] = own @ cloud.weights - outline.origin[:, None]
        delta = memory[:2]
        np.subtract(own, sensors[:, None], out=delta[:, mapped:])
        sensors -= outline.origin[:, None]
        np.subtract(place[:, :mapped, None], sensors[:, None], out=delta[:, :mapped])
        pose = cloud.delta
        if not model.has_bearing:
            pose = pose - np.deg2rad([[0.0], [0.0], [model.sensor.mount.yaw_deg]])
        # where nothing is behind any particle, no bearing need be wrapped
        ahead = float(np.minimum.reduce(delta[0], axis=None, initial=1.0)) > 0.0
        sight = model.sight_along(pose, delta, cloud.delta[2], out=memory[2:4], ahead=ahead)
        if not ahead:
            off, bearing = sight.bearing, np.arctan2(place[1], place[0])[:, None]
            off -= bearing
            wrap_in_place(off)
            off += bearing
        return sight

    def _variances(
        self, outline: Outline, rows: Index, mapped: int, place: Array, *, pending: Array, cloud: Cloud
    ) -> tuple[Array, Array, Array]:
        """Return covariances (3, C) of measurements, and the variances (2, C) in them by place and by pending noise.

        That is H Σ Hᵀ where the mean pose sees the mean place.
        """
        table, particles, model = self._table, self._particles, self._model
        spread = table.covariance.take(rows, axis=0).T
        spread[:, mapped:] = particles.covariances.take(table.slot[rows[mapped:]], axis=1) @ cloud.weights
        squares = place * place
        distance = np.sqrt(squares[0] + squares[1])
        centre = Sight(outline.axes.T @ place, distance, place[1], None, cloud.mean[:, None])
        if not model.has_bearing:
            centre = model.sight(cloud.mean[:, None], centre.delta + model.origin(cloud.mean)[0][:, None])
        by_feature = model.by_feature(centre)
        by_place = ekf.projected(by_feature, spread)
        by_pose = model.by_pose(centre, by_feature)
        moved = np.matmul(pending, by_pose)
        by_motion = np.add.reduce(by_pose.take((0, 0, 1), axis=0) * moved.take((0, 1, 1), axis=0), axis=1)
        return by_place + by_motion, by_place[::2], by_motion[::2]

    def _calibrated(self, sight: Sight, out: Array) -> Array:
        """Return measurements (2, C, M) as each particle's calibration makes the sensor show them."""
        scale, turn = self._calibration.means(self._particles)
        if not self._model.has_bearing:
            return np.asarray(np.multiply(sight.measurement, 1.0 + scale, out=out))
        np.multiply(sight.distance, 1.0 + scale, out=out[0])
        np.add(sight.bearing, turn, out=out[1])
        return out
