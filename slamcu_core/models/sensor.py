"""Measurement models z = h(x, m) for range-bearing and position sensors, with Jacobians (used by eq. 16-18).

The components of poses, points, measurements and matrices lead: poses are (3, ...) of x, y, heading, points and
measurements (2, ...), matrices (2, 2, ...). What follows broadcasts, features before particles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.drive import Detection, Sensor, SensorKind
from slamcu_core.errors import SlamcuError
from slamcu_core.geometry import wrap_angle, wrap_in_place

Array = NDArray[np.float64]


class Sight(NamedTuple):
    """Points as one sensor sees them from vehicle poses, with what the Jacobians need.

    `delta` (2, ...) leads from the sensor to the points in the local frame, `distance` (m) and `bearing` (rad from the
    sensor's axis, up to whole turns) are true; `ahead_left` (2, ...) is what a position sensor measures, else None.
    """

    delta: Array
    distance: Array
    bearing: Array
    ahead_left: Array | None
    pose: Array

    @property
    def measurement(self) -> Array:
        """What the sensor measures, h(x, m), shape (2, ...), a bearing up to whole turns."""
        return np.array([self.distance, self.bearing]) if self.ahead_left is None else self.ahead_left

    def some(self, index: NDArray[np.intp]) -> Sight:
        """Return the sight of some of F points, seen from M poses: each array is (..., F, M)."""
        ahead_left = None if self.ahead_left is None else self.ahead_left.take(index, axis=1)
        distance, bearing = self.distance.take(index, axis=0), self.bearing.take(index, axis=0)
        return Sight(self.delta.take(index, axis=1), distance, bearing, ahead_left, self.pose)


class Jacobian(NamedTuple):
    """H = ∂h/∂m of features: a rotation into the sensor's axes, or the line of sight, and for an angle a division.

    H = [[cos, sin], [-shrink · sin, shrink · cos]], with `shrink` the inverse of the distance for a bearing, else 1.
    """

    cos: Array
    sin: Array
    shrink: Array | float

    @property
    def matrix(self) -> Array:
        """H, shape (2, 2, ...)."""
        return np.array([[self.cos, self.sin], [-self.shrink * self.sin, self.shrink * self.cos]])

    def some(self, index: NDArray[np.intp]) -> Jacobian:
        """Return the Jacobians of some of F features, seen from M poses."""
        if isinstance(self.shrink, float):
            return self  # of a position sensor: the same for all features
        return Jacobian(self.cos.take(index, axis=0), self.sin.take(index, axis=0), self.shrink.take(index, axis=0))


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The measurement model of one sensor.

    A measurement has two components: range (m) and bearing (rad), or x and y (m) in the vehicle frame.
    """

    sensor: Sensor
    has_bearing: bool = field(init=False)  # whether component 1 of a measurement is an angle
    half_angle: float = field(init=False)  # rad, of the field of view
    log_clutter: float = field(init=False)  # ln of `clutter_density`

    def __post_init__(self) -> None:
        object.__setattr__(self, "has_bearing", self.sensor.kind is SensorKind.RANGE_BEARING)
        object.__setattr__(self, "half_angle", float(np.deg2rad(self.sensor.fov_deg)) / 2.0)
        object.__setattr__(self, "log_clutter", float(np.log(self.clutter_density)))

    def origin(self, pose: Array) -> tuple[Array, Array]:
        """Return the places (2, ...) and directions (...) of the sensor's axis for vehicle poses."""
        mount = self.sensor.mount
        if not mount.x and not mount.y and not mount.yaw_deg:
            return pose[:2], pose[2]
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        place = np.array([pose[0] + cos * mount.x - sin * mount.y, pose[1] + sin * mount.x + cos * mount.y])
        return place, pose[2] + np.deg2rad(mount.yaw_deg)

    def sight(self, pose: Array, points: Array) -> Sight:
        """Return how points look from vehicle poses."""
        place, direction = self.origin(pose)
        return self.sight_along(pose, _difference(points, place), direction)

    def sight_along(
        self, pose: Array, delta: Array, direction: Array, *, out: Array | None = None, ahead: bool = False
    ) -> Sight:
        """Return how points at `delta` (2, ...) from a sensor with an axis in the given direction look.

        `out` (2, ...) is memory for distances and bearings, `ahead` whether all first components are positive.
        """
        squares = np.multiply(delta, delta, out=out)
        distance = np.add(squares[0], squares[1], out=squares[0, ...])
        np.sqrt(distance, out=distance)
        if ahead:  # half the time of an arctangent in all quadrants
            bearing = np.divide(delta[1], delta[0], out=squares[1, ...])
            np.arctan(bearing, out=bearing)
        else:
            bearing = np.arctan2(delta[1], delta[0], out=squares[1, ...])
        bearing -= direction
        if self.has_bearing:
            return Sight(delta, distance, bearing, None, pose)
        cos, sin, mount = np.cos(pose[2]), np.sin(pose[2]), self.sensor.mount
        x, y = delta
        ahead_left = np.array([x * cos + y * sin + mount.x, y * cos - x * sin + mount.y])
        return Sight(delta, distance, bearing, ahead_left, pose)

    def predict(self, pose: Array, points: Array) -> Array:
        """Return the measurements h(x, m), shape (2, ...), of points from vehicle poses."""
        measurement = self.sight(pose, points).measurement
        if self.has_bearing:
            measurement[1] = wrap_angle(measurement[1])
        return measurement

    def by_feature(self, sight: Sight) -> Jacobian:
        """Return H = ∂h/∂m: the Jacobian with respect to the feature (errata to eq. 16)."""
        if not self.has_bearing:
            return Jacobian(np.cos(sight.pose[2]), np.sin(sight.pose[2]), 1.0)
        shrink = 1.0 / np.maximum(sight.distance, 1e-3)
        toward = sight.delta * shrink
        return Jacobian(toward[0], toward[1], shrink)

    def feature_jacobian(self, pose: Array, points: Array) -> Jacobian:
        """Return H = ∂h/∂m at points seen from vehicle poses."""
        return self.by_feature(self.sight(pose, points))

    def by_pose(self, sight: Sight, by_feature: Jacobian) -> Array:
        """Return ∂h/∂x, shape (2, 3, ...): the Jacobian with respect to the vehicle's x, y and heading."""
        h = np.empty((2, 3, *sight.distance.shape))
        np.negative(by_feature.cos, out=h[0, 0, ...])
        np.negative(by_feature.sin, out=h[0, 1, ...])
        np.multiply(by_feature.sin, by_feature.shrink, out=h[1, 0, ...])
        np.multiply(h[0, 0], by_feature.shrink, out=h[1, 1, ...])
        if not self.has_bearing:
            h[0, 2], h[1, 2] = sight.measurement[1], -sight.measurement[0]
            return h
        mount = self.sensor.mount
        h[0, 2], h[1, 2] = 0.0, -1.0
        if mount.x or mount.y:
            cos, sin = np.cos(sight.pose[2]), np.sin(sight.pose[2])
            swing = -sin * mount.x - cos * mount.y, cos * mount.x - sin * mount.y
            h[:, 2] += h[:, 0] * swing[0] + h[:, 1] * swing[1]
        return h

    def invert(self, pose: Array, measurement: Array) -> Array:
        """Return the points (2, ...) at which measurements (2, ...) place a feature: h(x, invert(x, z)) = z."""
        if self.has_bearing:
            place, direction = self.origin(pose)
            angle = direction + measurement[1]
            return np.array([place[0] + measurement[0] * np.cos(angle), place[1] + measurement[0] * np.sin(angle)])
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        x, y = measurement
        return np.array([pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y])

    def in_vehicle(self, measurement: Array) -> tuple[Array, Array]:
        """Return where measurements (2, D) are in the vehicle's frame, m, and directions (2, D) of their first axis."""
        toward = np.empty(measurement.shape)
        if not self.has_bearing:
            toward[0], toward[1] = 1.0, 0.0
            return measurement, toward
        mount = self.sensor.mount
        angle = measurement[1] + math.radians(mount.yaw_deg)
        np.cos(angle, out=toward[0])
        np.sin(angle, out=toward[1])
        ahead_left = measurement[0] * toward
        if mount.x or mount.y:
            ahead_left += [[mount.x], [mount.y]]
        return ahead_left, toward

    def information(
        self, cos: float, sin: float, distance: float, first: float, second: float
    ) -> tuple[float, float, float]:
        """Return how much a measurement in a direction tells of a place: Hᵀ R⁻¹ H as xx, xy, yy in 1/m².

        `distance` is what was measured first, `first` and `second` are its variances. That is 1/σ_r² along the line of
        sight and 1/(r σ_b)² across it.
        """
        along, across = 1.0 / first, 1.0 / second
        if self.has_bearing:
            distance = max(distance, 1e-3)
            across /= distance * distance
        more = (along - across) * cos
        xx = more * cos + across
        return xx, more * sin, along + across - xx

    def born(self, pose: Array, measurement: Array) -> tuple[Array, Jacobian]:
        """Return the points (2, ...) at which measurements (2, ...) place a feature, and H there."""
        if not self.has_bearing:
            return self.invert(pose, measurement), Jacobian(np.cos(pose[2]), np.sin(pose[2]), 1.0)
        place, direction = self.origin(pose)
        angle = direction + measurement[1]
        cos, sin = np.cos(angle), np.sin(angle)
        distance = np.maximum(measurement[0], 1e-3)
        points = np.array([place[0] + distance * cos, place[1] + distance * sin])
        return points, Jacobian(cos, sin, 1.0 / distance)

    def noise(self, measurement: ArrayLike) -> Array:
        """Return the variances (2, ...) of R_t for measurements (2, ...); range noise grows with range."""
        z = np.asarray(measurement, float)
        variance = np.empty(z.shape)
        sensor = self.sensor
        if self.has_bearing:
            std = sensor.range_std_rel * z[0]
            std += sensor.range_std_m
            variance[0], variance[1] = std * std, sensor.bearing_std_rad**2
        else:
            variance[...] = sensor.position_std_m**2
        return variance

    def innovation(self, measurement: Array, predicted: Array) -> Array:
        """Return z - ẑ, shape (2, ...), with the bearing wrapped."""
        nu = measurement - predicted
        if self.has_bearing:
            wrap_in_place(nu[1, ...])
        return nu

    def measurements(self, detections: Sequence[Detection]) -> Array:
        """Return the two components of D detections, (2, D).

        Raises SlamcuError if a detection lacks what this kind of sensor measures.
        """
        if self.has_bearing:
            parts = [detection.range for detection in detections], [detection.bearing for detection in detections]
        else:
            parts = [detection.x for detection in detections], [detection.y for detection in detections]
        if None in parts[0] or None in parts[1]:
            expected = "range and bearing" if self.has_bearing else "x and y"
            raise SlamcuError(f"a detection of sensor {self.sensor.id!r} needs {expected}")
        return np.array(parts, float)

    @property
    def clutter_density(self) -> float:
        """Expected false alarms a frame per unit of measurement space (m·rad, or m²)."""
        s = self.sensor
        if self.has_bearing:
            volume = (s.max_range_m - s.min_range_m) * 2.0 * self.half_angle
        else:
            volume = self.half_angle * (s.max_range_m**2 - s.min_range_m**2)
        return float(max(s.false_alarms_per_frame, 1e-4) / max(volume, 1e-6))


def _difference(points: Array, places: Array) -> Array:
    """Return points (2, ...) minus places (2, ...), which may lack the axis of the features."""
    return np.asarray(points - (places[:, None] if points.ndim > places.ndim else places))
