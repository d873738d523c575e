"""Places: SENSORIS positions in any of its frames to longitude, latitude and an east-north covariance, and back."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from slamcu_core.errors import WireError
from slamcu_core.geometry import LocalFrame
from slamcu_core.reports import MeasuredPosition
from slamcu_core.sensoris.covariance import east_north_covariance, horizontal_covariance, write_covariance
from slamcu_core.sensoris.orientation import integer, rotation_matrix, yaw_variance
from slamcu_core.sensoris.policy import ThirdPartyDefaults, WireLimits
from slamcu_core.sensoris.proto import data_pb2, localization_pb2, spatial_pb2
from slamcu_core.sensoris.times import read_timestamp

Array = NDArray[np.float64]

DEGREE = 1e8
_MM = 1e3
_SAME_INSTANT = timedelta(milliseconds=20)  # 0.7 m at 36 m/s


def write_position(target: spatial_pb2.PositionAndAccuracy, position: MeasuredPosition) -> None:
    """Set a SENSORIS position to a place on WGS84 with its covariance; nothing is said of its altitude."""
    target.geographic_wgs84.longitude.value = round(position.lon * DEGREE)
    target.geographic_wgs84.latitude.value = round(position.lat * DEGREE)
    write_covariance(target.covariance, position.covariance_m2)


@dataclass(frozen=True)
class _Frame:
    """Metric axes somewhere on the globe: origin, axes (columns in east-north-up), and how sure these are."""

    lon: float
    lat: float
    axes: Array  # (3, 3)
    covariance: Array  # (2, 2) of the origin, east-north, m²
    yaw_variance: float  # rad²

    def place(self, offset: Array, covariance: Array) -> MeasuredPosition:
        """Return the place of an offset (3,) in metres whose covariance (3, 3) is along these axes."""
        turned = (self.axes @ offset)[:2]
        lon, lat = LocalFrame(self.lon, self.lat).to_geographic(turned)
        across = np.array([-turned[1], turned[0]])  # where a small turn of the axes moves the place
        total = (
            (self.axes @ covariance @ self.axes.T)[:2, :2]
            + self.covariance
            + self.yaw_variance * np.outer(across, across)
        )
        return MeasuredPosition(float(lon), float(lat), (float(total[0, 0]), float(total[0, 1]), float(total[1, 1])))


class PositionReader:
    """Reads the positions of one event group.

    Metric positions are relative to the group's origin, or to the vehicle where it was at the event's instant (which
    the group's VehiclePositionAndOrientation events say). The uncertainty of that origin and heading is added: a
    MeasuredPosition includes the pose's.

    Parameters
    ----------
    group : the event group.
    limits, defaults : bounds, and the accuracy of positions that state none.
    """

    def __init__(self, group: data_pb2.EventGroup, limits: WireLimits, defaults: ThirdPartyDefaults) -> None:
        self._group, self._limits, self._defaults = group, limits, defaults
        self._poses: list[tuple[datetime, localization_pb2.VehiclePositionAndOrientation]] | None = None

    def read(self, position: spatial_pb2.PositionAndAccuracy, instant: datetime) -> MeasuredPosition:
        """Return the place that an event at an instant gives.

        Raises WireError with reason ``unresolvable-position``, ``position-out-of-range`` or ``bad-covariance``.
        """
        kind = position.WhichOneof("geographic_metric")
        if kind == "geographic_wgs84":
            lon, lat = self._geographic(position)
            return MeasuredPosition(lon, lat, east_north_covariance(position, self._defaults.position_std_m))
        if kind == "metric_event_group":
            return self._metric(position, position.metric_event_group, self._origin())
        if kind == "metric_vehicle":
            return self._metric(position, position.metric_vehicle, self._vehicle(instant))
        raise WireError(
            "unresolvable-position",
            f"a position by {kind or 'nothing'}, expected geographic_wgs84, metric_event_group or metric_vehicle",
        )

    def _geographic(self, position: spatial_pb2.PositionAndAccuracy) -> tuple[float, float]:
        place = position.geographic_wgs84
        lon, lat = integer(place.longitude), integer(place.latitude)
        if lon is None or lat is None:
            raise WireError("unresolvable-position", "a geographic position needs longitude and latitude")
        altitude = integer(place.altitude) if place.HasField("altitude") else None
        low, high = self._limits.altitude_m
        if not (abs(lon) <= 180 * DEGREE and abs(lat) <= 90 * DEGREE) or (
            altitude is not None and not low * _MM <= altitude <= high * _MM
        ):
            raise WireError(
                "position-out-of-range",
                f"longitude {lon / DEGREE:g}, latitude {lat / DEGREE:g}, altitude {(altitude or 0) / _MM:g} m; "
                "expected [-180, 180] and [-90, 90] degrees (integers with exponent 8) "
                f"and {low:g} to {high:g} m (exponent 3)",
            )
        return lon / DEGREE, lat / DEGREE

    def _metric(
        self, position: spatial_pb2.PositionAndAccuracy, metric: spatial_pb2.PositionAndAccuracy.Metric, frame: _Frame
    ) -> MeasuredPosition:
        x, y, z = integer(metric.x), integer(metric.y), integer(metric.z, 0)
        if x is None or y is None or z is None:
            raise WireError("unresolvable-position", "a metric position needs x and y")
        offset = np.array([x, y, z]) / _MM
        if math.hypot(*offset) > self._limits.max_offset_m:
            raise WireError(
                "position-out-of-range",
                f"a position {math.hypot(*offset):g} m from its origin, "
                f"expected at most {self._limits.max_offset_m:g} m",
            )
        covariance = horizontal_covariance(position, self._defaults.position_std_m)
        if position.WhichOneof("accuracy") == "horizontal_confidence_ellipse_vertical_std_dev":
            covariance = frame.axes.T @ covariance @ frame.axes  # its heading is from north, not from the frame's axes
        return frame.place(offset, covariance)

    def _origin(self) -> _Frame:
        if not self._group.envelope.HasField("origin"):
            raise WireError("unresolvable-position", "a position relative to an event group that has no origin")
        origin = self._group.envelope.origin
        if origin.position_and_accuracy.WhichOneof("geographic_metric") != "geographic_wgs84":
            raise WireError("unresolvable-position", "the origin of an event group must be geographic_wgs84")
        turned = origin.HasField("orientation_and_accuracy")
        lon, lat = self._geographic(origin.position_and_accuracy)
        return _Frame(
            lon,
            lat,
            rotation_matrix(origin.orientation_and_accuracy) if turned else np.eye(3),
            _stated_covariance(origin.position_and_accuracy),
            yaw_variance(origin.orientation_and_accuracy) if turned else 0.0,
        )

    def _vehicle(self, instant: datetime) -> _Frame:
        pose = self._pose_at(instant)
        position, orientation = pose.position_and_accuracy, pose.orientation_and_accuracy
        relative = position.WhichOneof("geographic_metric") == "metric_event_group"
        by_group = (orientation.WhichOneof("euler_quaternion") or "").endswith("event_group")
        base = self._origin().axes if relative or by_group else np.eye(3)
        place = self.read(position, instant)
        xx, xy, yy = place.covariance_m2
        stated = relative or position.WhichOneof("accuracy") is not None
        return _Frame(
            place.lon,
            place.lat,
            base @ rotation_matrix(orientation),
            np.array([[xx, xy], [xy, yy]]) if stated else np.zeros((2, 2)),
            yaw_variance(orientation),
        )

    def _pose_at(self, instant: datetime) -> localization_pb2.VehiclePositionAndOrientation:
        if self._poses is None:
            self._poses = sorted(self._usable_poses(), key=lambda pose: pose[0])
        after = bisect_left(self._poses, instant, key=lambda pose: pose[0])
        near = self._poses[max(after - 1, 0) : after + 1]
        at, pose = min(near, key=lambda pose: abs(pose[0] - instant), default=(None, None))
        if at is None or pose is None or abs(at - instant) > _SAME_INSTANT:
            raise WireError(
                "unresolvable-position",
                "a position in vehicle axes needs a VehiclePositionAndOrientation of its instant in the event group",
            )
        return pose

    def _usable_poses(self) -> Iterator[tuple[datetime, localization_pb2.VehiclePositionAndOrientation]]:
        for pose in self._group.localization_category.vehicle_position_and_orientation:
            instant = read_timestamp(pose.envelope.timestamp)
            kind = pose.position_and_accuracy.WhichOneof("geographic_metric")
            placed = kind in ("geographic_wgs84", "metric_event_group")
            if instant is not None and placed and pose.HasField("orientation_and_accuracy"):
                yield instant, pose


def _stated_covariance(position: spatial_pb2.PositionAndAccuracy) -> Array:
    """Return the covariance (2, 2) that an origin states; one that states none is an anchor, not a measurement."""
    if position.WhichOneof("accuracy") is None:
        return np.zeros((2, 2))
    return horizontal_covariance(position, 0.0)[:2, :2]
