"""What a car may hand to the filter, record by record: one NaN would poison every particle."""

from __future__ import annotations

import math
from collections.abc import Mapping

from slamcu_core.drive import (
    Detection,
    DetectionFrame,
    GnssFix,
    Occluder,
    Odometry,
    Record,
    Sensor,
    SensorKind,
)
from slamcu_core.errors import FieldError, SlamcuError
from slamcu_core.models import yaw_rate_from_steering

_MOST_SPEED = 150.0  # m/s, either way
_MOST_YAW_RATE = 10.0  # rad/s, either way
_MOST_STEERING = 1.57  # rad; at a right angle the wheels only slide
_FAR_M = 1e4  # m; what is measured lies within
_MOST_BEARING = 2.0 * math.pi  # rad
_METRES, _RADIANS = "metres in [0, 10000]", "radians, at most a whole turn either way"
_GNSS_STD_M = 1e-3, 1e5  # m


def check_record(record: Record, sensors: Mapping[str, Sensor], *, wheelbase_m: float | None) -> None:
    """Check one record by itself.

    Parameters
    ----------
    record : what the car measured.
    sensors : the header's sensors by id.
    wheelbase_m : as the header has it; steering angles need it.

    Raises SlamcuError, FieldError where one field is to blame, naming what was expected.
    """
    if not 0.0 <= record.t < math.inf:
        raise FieldError("t", "seconds since the start of the drive", record.t)
    if isinstance(record, Odometry):
        _check_odometry(record, wheelbase_m)
    elif isinstance(record, GnssFix):
        _check(-180.0 <= record.lon <= 180.0, "lon", record.lon, "degrees in [-180, 180]")
        _check(-90.0 <= record.lat <= 90.0, "lat", record.lat, "degrees in [-90, 90]")
        low, high = _GNSS_STD_M
        _check(low <= record.std_m <= high, "std_m", record.std_m, f"metres in [{low:g}, {high:g}]")
    else:
        sensor = sensors.get(record.sensor)
        if sensor is None:
            raise SlamcuError(f"sensor {record.sensor!r} is not in the header, which has {sorted(sensors)}")
        if isinstance(record, DetectionFrame):
            for index, item in enumerate(record.items):
                _check_detection(item, index, sensor.kind)
        else:
            for index, occluder in enumerate(record.items):
                _check_occluder(occluder, index)


def _check_odometry(record: Odometry, wheelbase_m: float | None) -> None:
    speed, yaw_rate, steering = record.speed, record.yaw_rate, record.steering
    _check(abs(speed) <= _MOST_SPEED, "speed", speed, f"m/s in [-{_MOST_SPEED:g}, {_MOST_SPEED:g}]")
    if (yaw_rate is None) == (steering is None):
        raise SlamcuError("odometry needs either yaw_rate or steering")
    if yaw_rate is not None:
        _check(abs(yaw_rate) <= _MOST_YAW_RATE, "yaw_rate", yaw_rate, f"rad/s, at most {_MOST_YAW_RATE:g} either way")
    elif steering is not None:
        _check(abs(steering) <= _MOST_STEERING, "steering", steering, f"rad, at most {_MOST_STEERING:g} either way")
        turn = yaw_rate_from_steering(speed, steering, wheelbase_m)
        expected = f"such that the car turns by at most {_MOST_YAW_RATE:g} rad/s"
        _check(abs(turn) <= _MOST_YAW_RATE, "steering", steering, expected)


def _check_detection(item: Detection, index: int, kind: SensorKind) -> None:
    # names are put together only for what is wrong: this is done for every detection of a drive
    if kind is SensorKind.RANGE_BEARING:
        if item.range is None or not 0.0 <= item.range <= _FAR_M:
            raise FieldError(f"items[{index}].range", _METRES, item.range)
        if item.bearing is None or not abs(item.bearing) <= _MOST_BEARING:
            raise FieldError(f"items[{index}].bearing", _RADIANS, item.bearing)
    else:
        if item.x is None or not abs(item.x) <= _FAR_M:
            raise FieldError(f"items[{index}].x", "metres, at most 10 km", item.x)
        if item.y is None or not abs(item.y) <= _FAR_M:
            raise FieldError(f"items[{index}].y", "metres, at most 10 km", item.y)
    if not 0.0 <= item.confidence <= 1.0:
        raise FieldError(f"items[{index}].confidence", "a number in [0, 1]", item.confidence)


def _check_occluder(item: Occluder, index: int) -> None:
    if not 0.0 < item.range <= _FAR_M:
        raise FieldError(f"items[{index}].range", "metres above 0, at most 10 km", item.range)
    if not abs(item.bearing) <= _MOST_BEARING:
        raise FieldError(f"items[{index}].bearing", _RADIANS, item.bearing)
    if not 0.0 <= item.width <= _FAR_M:
        raise FieldError(f"items[{index}].width", "metres, at least 0 and at most 10 km", item.width)


def _check(holds: bool, field: str, value: object, expected: str) -> None:
    if not holds:
        raise FieldError(field, expected, value)
