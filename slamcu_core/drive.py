"""What a car hands to the filter: its sensors, its start, and the records of a drive.

The same types serve a live car and a recorded log (`slamcu_core.formats.drive_log` reads the latter).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from slamcu_core.errors import FieldError, check_within

MOST_REACH_M = 2_000.0
"""No sensor reaches farther: what the map has within reach is looked up again every few metres."""

_TINY = 1e-6  # m or rad; variances below its square would be lost in rounding


class SensorKind(StrEnum):
    """How a sensor measures the place of a feature."""

    RANGE_BEARING = "range_bearing"
    POSITION = "position"


@dataclass(frozen=True, slots=True)
class Mount:
    """Pose of a sensor in the vehicle frame (origin at the middle of the rear axle, x forward, y left)."""

    x: float = 0.0  # m
    y: float = 0.0  # m
    yaw_deg: float = 0.0  # counter-clockwise from straight ahead

    def __post_init__(self) -> None:
        """Raise FieldError for a place that is on no vehicle."""
        check_within(self, "x", -100.0, 100.0, "m")
        check_within(self, "y", -100.0, 100.0, "m")
        check_within(self, "yaw_deg", -360.0, 360.0, "degrees")


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor that detects map features, as the header of a drive log describes it (formats.md)."""

    id: str
    kind: SensorKind = SensorKind.RANGE_BEARING
    fov_deg: float = 40.0  # full horizontal field of view
    min_range_m: float = 0.0
    max_range_m: float = 80.0
    rate_hz: float = 15.0
    mount: Mount = field(default_factory=Mount)
    range_std_m: float = 0.3  # standard deviation of range is range_std_m + range_std_rel * range
    range_std_rel: float = 0.0
    bearing_std_rad: float = 0.01
    position_std_m: float = 0.3  # of x and y each, kind position only
    detection_probability: float = 0.9
    false_alarms_per_frame: float = 0.01
    classes: tuple[str, ...] = ("traffic_sign",)

    def __post_init__(self) -> None:
        """Raise FieldError for what no sensor is like."""
        check_within(self, "fov_deg", _TINY, 360.0, "degrees")
        check_within(self, "min_range_m", 0.0, MOST_REACH_M, "m")
        check_within(self, "max_range_m", 0.1, MOST_REACH_M, "m")
        if not self.max_range_m > self.min_range_m:
            raise FieldError("max_range_m", f"above min_range_m, {self.min_range_m:g}", self.max_range_m)
        check_within(self, "rate_hz", _TINY, 1e6, "Hz")
        check_within(self, "range_std_m", 0.0, 1e3, "m")
        check_within(self, "range_std_rel", 0.0, 10.0, "of the range")
        if self.kind is SensorKind.RANGE_BEARING and max(self.range_std_m, self.range_std_rel) < _TINY:
            raise FieldError("range_std_m", f"at least {_TINY:g} m, or range_std_rel", self.range_std_m)
        check_within(self, "bearing_std_rad", _TINY, 10.0, "rad")
        check_within(self, "position_std_m", _TINY, 1e3, "m")
        check_within(self, "detection_probability", _TINY, 1.0, "")
        check_within(self, "false_alarms_per_frame", 0.0, 1e3, "")


@dataclass(frozen=True, slots=True)
class InitialPose:
    """Where a drive starts and how sure that is."""

    lon: float  # degrees
    lat: float  # degrees
    heading_deg: float  # compass, clockwise from north
    position_std_m: float = 1.5  # each axis
    heading_std_deg: float = 2.0

    def __post_init__(self) -> None:
        """Raise FieldError for a place that is nowhere, or known no better than a continent."""
        check_within(self, "lon", -180.0, 180.0, "degrees")
        check_within(self, "lat", -90.0, 90.0, "degrees")
        check_within(self, "heading_deg", -360.0, 360.0, "degrees")
        check_within(self, "position_std_m", 0.0, 1e5, "m")
        check_within(self, "heading_std_deg", 0.0, 360.0, "degrees")


@dataclass(frozen=True, slots=True)
class DriveHeader:
    """The first line of a drive log: who drives, when, where from and with which sensors."""

    vehicle_id: str
    session_id: str
    start_time: datetime  # aware; the instant of t = 0
    initial_pose: InitialPose
    sensors: tuple[Sensor, ...]
    fleet_id: str = ""
    wheelbase_m: float | None = None

    def __post_init__(self) -> None:
        """Raise FieldError for a wheelbase that no vehicle has."""
        if self.wheelbase_m is not None:
            check_within(self, "wheelbase_m", 0.01, 100.0, "m")


@dataclass(frozen=True, slots=True)
class Odometry:
    """Speed with either yaw rate or front wheel angle; holds from t on, until the next or `MotionNoise.hold_s`."""

    t: float  # s since the start of the drive
    speed: float  # m/s, forward positive
    yaw_rate: float | None = None  # rad/s, counter-clockwise positive
    steering: float | None = None  # front wheel angle, rad


@dataclass(frozen=True, slots=True)
class GnssFix:
    """A satellite position."""

    t: float
    lon: float
    lat: float
    std_m: float  # each axis


@dataclass(frozen=True, slots=True)
class Detection:
    """One feature that a sensor saw; range and bearing, or x and y in the vehicle frame, by the sensor's kind."""

    feature_class: str
    range: float | None = None  # m from the sensor
    bearing: float | None = None  # rad from the sensor's axis, counter-clockwise
    x: float | None = None  # m forward
    y: float | None = None  # m left
    sign: str | None = None  # SENSORIS TrafficSign type name; None: not recognised
    value: str | None = None
    confidence: float = 0.9  # existence confidence λ of eq. 1


@dataclass(frozen=True, slots=True)
class DetectionFrame:
    """All that one sensor saw at one instant; no items: it looked and saw nothing, which is evidence."""

    t: float
    sensor: str
    items: tuple[Detection, ...] = ()


@dataclass(frozen=True, slots=True)
class Occluder:
    """An object that can hide features behind it."""

    range: float  # m to its near face
    bearing: float  # rad to its middle
    width: float  # m across the line of sight
    object_class: str = "truck"


@dataclass(frozen=True, slots=True)
class ObjectFrame:
    """The objects that one sensor saw at one instant."""

    t: float
    sensor: str
    items: tuple[Occluder, ...] = ()


Record = Odometry | GnssFix | DetectionFrame | ObjectFrame
