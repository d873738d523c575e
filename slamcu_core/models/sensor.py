"""Measurement models z = h(x, m) for range-bearing and position sensors, with Jacobians (used by eq. 16-18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.drive import Detection, Sensor, SensorKind
from slamcu_core.errors import SlamcuError
from slamcu_core.geometry import wrap_angle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The measurement model of one sensor.

    A measurement has two components: range (m) and bearing (rad), or x and y (m) in the vehicle frame. Poses are
    (..., 3) of x, y, heading of the vehicle; points are (..., 2) and broadcast against them.
    """

    sensor: Sensor

    @property
    def has_bearing(self) -> bool:
        """Whether component 1 is an angle."""
        return self.sensor.kind is SensorKind.RANGE_BEARING

    def origin(self, pose: Array) -> tuple[Array, Array]:
        """Return the places (..., 2) and directions (...) of the sensor's axis for vehicle poses."""
        mount = self.sensor.mount
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        place = np.stack(
            [pose[..., 0] + cos * mount.x - sin * mount.y, pose[..., 1] + sin * mount.x + cos * mount.y], axis=-1
        )
        return place, pose[..., 2] + np.deg2rad(mount.yaw_deg)

    def polar(self, pose: Array, points: Array) -> tuple[Array, Array]:
        """Return true range (m) and bearing from the sensor's axis (rad, wrapped) of points, for visibility."""
        place, direction = self.origin(pose)
        delta = points - place
        return np.hypot(delta[..., 0], delta[..., 1]), wrap_angle(np.arctan2(delta[..., 1], delta[..., 0]) - direction)

    def predict(self, pose: Array, points: Array) -> Array:
        """Return the measurements h(x, m), shape (..., 2), of points from vehicle poses."""
        if self.has_bearing:
            return np.stack(self.polar(pose, points), axis=-1)
        delta = points - pose[..., :2]
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        return np.stack(
            [cos * delta[..., 0] + sin * delta[..., 1], -sin * delta[..., 0] + cos * delta[..., 1]], axis=-1
        )

    def feature_jacobian(self, pose: Array, points: Array) -> Array:
        """Return H = ∂h/∂m, shape (..., 2, 2): the Jacobian with respect to the feature (errata to eq. 16)."""
        if not self.has_bearing:
            cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
            shape = np.broadcast_shapes(pose[..., 0].shape, points[..., 0].shape)
            h = np.empty((*shape, 2, 2))
            h[..., 0, 0], h[..., 0, 1], h[..., 1, 0], h[..., 1, 1] = cos, sin, -sin, cos
            return h
        place, _ = self.origin(pose)
        delta = points - place
        square = np.maximum(delta[..., 0] ** 2 + delta[..., 1] ** 2, 1e-6)
        distance = np.sqrt(square)
        h = np.empty((*square.shape, 2, 2))
        h[..., 0, 0], h[..., 0, 1] = delta[..., 0] / distance, delta[..., 1] / distance
        h[..., 1, 0], h[..., 1, 1] = -delta[..., 1] / square, delta[..., 0] / square
        return h

    def pose_jacobian(self, pose: Array, points: Array) -> Array:
        """Return ∂h/∂x, shape (..., 2, 3): the Jacobian with respect to the vehicle's x, y and heading."""
        by_feature = self.feature_jacobian(pose, points)
        h = np.empty((*by_feature.shape[:-1], 3))
        h[..., :2] = -by_feature
        if not self.has_bearing:
            z = self.predict(pose, points)
            h[..., 0, 2], h[..., 1, 2] = z[..., 1], -z[..., 0]
            return h
        mount = self.sensor.mount
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        swing = np.stack([-sin * mount.x - cos * mount.y, cos * mount.x - sin * mount.y], axis=-1)
        h[..., 2] = -(by_feature @ swing[..., None])[..., 0]
        h[..., 1, 2] -= 1.0
        return h

    def invert(self, pose: Array, measurement: Array) -> Array:
        """Return the points (..., 2) at which measurements (..., 2) place a feature: h(x, invert(x, z)) = z."""
        if self.has_bearing:
            place, direction = self.origin(pose)
            angle = direction + measurement[..., 1]
            distance = measurement[..., 0]
            return np.stack(
                [place[..., 0] + distance * np.cos(angle), place[..., 1] + distance * np.sin(angle)], axis=-1
            )
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        x, y = measurement[..., 0], measurement[..., 1]
        return np.stack([pose[..., 0] + cos * x - sin * y, pose[..., 1] + sin * x + cos * y], axis=-1)

    def noise(self, measurement: ArrayLike) -> Array:
        """Return the variances (..., 2) of R_t for measurements (..., 2); range noise grows with range."""
        z = np.asarray(measurement, float)
        variance = np.empty_like(z)
        if self.has_bearing:
            variance[..., 0] = (self.sensor.range_std_m + self.sensor.range_std_rel * z[..., 0]) ** 2
            variance[..., 1] = self.sensor.bearing_std_rad**2
        else:
            variance[...] = self.sensor.position_std_m**2
        return variance

    def innovation(self, measurement: Array, predicted: Array) -> Array:
        """Return z - ẑ, shape (..., 2), with the bearing wrapped."""
        nu = measurement - predicted
        if self.has_bearing:
            nu[..., 1] = wrap_angle(nu[..., 1])
        return nu

    def measurement(self, detection: Detection) -> tuple[float, float]:
        """Return the two components of a detection.

        Raises SlamcuError if the detection lacks what this kind of sensor measures.
        """
        first, second = (detection.range, detection.bearing) if self.has_bearing else (detection.x, detection.y)
        if first is None or second is None:
            expected = "range and bearing" if self.has_bearing else "x and y"
            raise SlamcuError(f"a detection of sensor {self.sensor.id!r} needs {expected}")
        return first, second

    @property
    def clutter_density(self) -> float:
        """Expected false alarms a frame per unit of measurement space (m·rad, or m²)."""
        s = self.sensor
        half_angle = np.deg2rad(s.fov_deg) / 2.0
        if self.has_bearing:
            volume = (s.max_range_m - s.min_range_m) * 2.0 * half_angle
        else:
            volume = half_angle * (s.max_range_m**2 - s.min_range_m**2)
        return float(max(s.false_alarms_per_frame, 1e-4) / max(volume, 1e-6))
