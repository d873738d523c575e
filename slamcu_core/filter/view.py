"""What a frame is about: the detections, and what the sensor should see of the rows within reach (section 4.3.1)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Detection, Occluder
from slamcu_core.evidence import support_of
from slamcu_core.filter import ekf
from slamcu_core.filter.association import Marginal, marginalise
from slamcu_core.filter.calibration import SensorCalibration
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.scratch import Scratch
from slamcu_core.filter.table import FeatureTable, Kind, Vocabulary
from slamcu_core.geometry import wrap_angle, wrap_in_place
from slamcu_core.models import SensorModel, Sight, occlusion_probability, visibility_probability

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Seen:
    """The detections of a frame as arrays: D measurements with variances and codes."""

    measurement: Array  # (2, D)
    noise: Array  # (2, D)
    ahead_left: Array  # (2, D) m, where they are as seen from the vehicle
    toward: Array  # (2, D) the direction of the measurement's first axis there
    feature_class: Index
    sign: Index
    value: Index
    weight: Array  # of eq. 1

    @property
    def named(self) -> bool:
        """Whether the sign or value of any was read."""
        return bool(self.sign.any() or self.value.any())

    def keep(self, which: NDArray[np.bool_]) -> Seen:
        """Return only some of the detections, (D,)."""
        if which.all():
            return self
        return Seen(*(getattr(self, item.name)[..., which] for item in fields(self)))


def read_detections(model: SensorModel, items: tuple[Detection, ...], names: Vocabulary) -> Seen:
    """Turn detections into arrays; raises SlamcuError if one lacks what its sensor measures."""
    measurement = np.array([model.measurement(item) for item in items], float).reshape(-1, 2).T
    feature_class = np.array([names.code(item.feature_class) for item in items], dtype=np.intp)
    sign = value = np.zeros(len(items), dtype=np.intp)
    if any(item.sign is not None or item.value is not None for item in items):
        sign = np.array([names.code(item.sign) for item in items], dtype=np.intp)
        value = np.array([names.code(item.value) for item in items], dtype=np.intp)
    weight = np.array([support_of(item.confidence) for item in items])
    return Seen(
        measurement, model.noise(measurement), *model.in_vehicle(measurement), feature_class, sign, value, weight
    )


@dataclass(frozen=True, slots=True)
class View:
    """What one sensor should see at one instant of F rows, the map's first, then the car's own finds.

    `visible` (F,) is P(visible) by field of view, `hidden` (F,) the probability of occlusion, `shown` (F,) that neither
    keeps it from sight. Of the variances of what
    would be measured, `by_place` (2, F) comes from where the feature may be, `by_motion` (2, F) from the pending noise
    of the poses.
    """

    rows: Index
    mapped: int  # how many of the rows are the map's
    visible: Array
    hidden: Array
    shown: Array
    marginal: Marginal
    by_place: Array
    by_motion: Array


def look(
    model: SensorModel,
    table: FeatureTable,
    particles: Particles,
    calibration: SensorCalibration,
    rows: Index,
    *,
    weights: Array,
    mean_pose: Array,
    occluders: tuple[Occluder, ...],
    scratch: Scratch,
) -> View:
    """Predict what a sensor should see of the given rows, which have the car's own finds last."""
    mapped = len(rows) - int(np.count_nonzero(table.kind[rows] == Kind.NEW))
    slots = table.slot[rows[mapped:]]
    own = particles.means.take(slots, axis=1)
    xy = table.xy.T.take(rows, axis=1)
    xy[:, mapped:] = own @ weights
    spread = table.covariance.T.take(rows, axis=1)
    spread[:, mapped:] = particles.covariances.take(slots, axis=1) @ weights
    place, direction = model.origin(particles.pose)
    memory = scratch.array(7, len(rows), len(particles))
    delta = memory[:2]
    np.subtract(xy[:, :mapped, None], place[:, None], out=delta[:, :mapped])
    np.subtract(own, place[:, None], out=delta[:, mapped:])
    sight = model.sight_along(particles.pose, delta, direction, out=memory[2:4])
    mean_distance = sight.distance @ weights
    reference, deviation, bearing = _deviations(model, particles, sight, int(weights.argmax()), memory[4:])
    visible = visibility_probability(model.sensor, sight.distance, bearing, weights)
    # by place and by pending noise: H Σ Hᵀ where the mean pose sees the mean place
    centre = model.sight(mean_pose[:, None], xy)
    by_feature = model.by_feature(centre)
    by_place = ekf.projected(by_feature, spread)
    by_motion = _by_motion(model.by_pose(centre, by_feature), particles.pending_covariance(weights))
    extra = by_place + by_motion
    extra[::2] += calibration.measurement_variance(mean_distance)
    marginal = marginalise(deviation, weights, reference, extra, scratch=delta)
    hidden, shown = np.zeros(len(rows)), visible
    if occluders:
        bearing_std = np.sqrt(marginal.covariance[2]) if model.has_bearing else np.full(len(rows), 0.01)
        hidden = occlusion_probability(occluders, mean_distance, wrap_angle(centre.bearing), bearing_std)
        shown = visible * (1.0 - hidden)
    return View(rows, mapped, visible, hidden, shown, marginal, by_place[::2], by_motion[::2])


def _deviations(
    model: SensorModel, particles: Particles, sight: Sight, best: int, out: Array
) -> tuple[Array, Array, Array]:
    """Return what the best particle should measure (2, F), what all differ from that (2, F, M), and bearings (F, M).

    Measurements are as each particle's calibration makes the sensor show them; bearings are true, within ±2π. `out`
    (3, F, M) takes them up.
    """
    scale, turn = particles.calibration
    if not model.has_bearing:
        predicted = sight.measurement * (1.0 + scale)
        reference = predicted[:, :, best].copy()
        return reference, predicted - reference[:, :, None], wrap_angle(sight.bearing)
    reference = np.empty((2, len(sight.distance)))
    deviation, bearing = out[:2], out[2]
    np.multiply(sight.distance, 1.0 + scale, out=deviation[0])
    reference[0], reference[1] = deviation[0, :, best], sight.bearing[:, best]
    deviation[0] -= reference[0, :, None]
    beside = np.subtract(sight.bearing, reference[1, :, None], out=deviation[1])
    wrap_in_place(beside, scratch=bearing)
    reference[1] = wrap_angle(reference[1])
    np.add(beside, reference[1, :, None], out=bearing)
    beside += turn - turn[best]
    reference[1] += turn[best]
    return reference, deviation, bearing


def _by_motion(by_pose: Array, pending: Array) -> Array:
    """Return the covariances (3, F) that pending noise of the pose (3, 3) gives what is measured."""
    moved = np.matmul(pending, by_pose)
    result = np.empty((3, by_pose.shape[2]))
    np.add.reduce(by_pose[0] * moved[0], axis=0, out=result[0])
    np.add.reduce(by_pose[0] * moved[1], axis=0, out=result[1])
    np.add.reduce(by_pose[1] * moved[1], axis=0, out=result[2])
    return result
