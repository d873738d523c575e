"""What a live car may hand in: checked before the filter sees it, because one NaN would poison every particle."""

from __future__ import annotations

import math
from collections.abc import Mapping

from slamcu_client.errors import SessionError
from slamcu_core.drive import (
    Detection,
    DetectionFrame,
    GnssFix,
    ObjectFrame,
    Occluder,
    Odometry,
    Record,
    Sensor,
    SensorKind,
)


def check_record(record: Record, sensors: Mapping[str, Sensor], *, wheelbase_known: bool) -> None:
    """Check one record.

    Parameters
    ----------
    record : what the car measured.
    sensors : the header's sensors by id.
    wheelbase_known : whether the header has the wheelbase that steering angles need.

    Raises SessionError naming the field and what was expected.
    """
    _require(0.0 <= record.t < math.inf, "t", record.t, "seconds since the start of the drive")
    if isinstance(record, Odometry):
        _check_odometry(record, wheelbase_known=wheelbase_known)
    elif isinstance(record, GnssFix):
        _require(-180.0 <= record.lon <= 180.0, "lon", record.lon, "degrees in [-180, 180]")
        _require(-90.0 <= record.lat <= 90.0, "lat", record.lat, "degrees in [-90, 90]")
        _require(0.0 < record.std_m < math.inf, "std_m", record.std_m, "metres above 0")
    else:
        sensor = sensors.get(record.sensor)
        if sensor is None:
            raise SessionError(f"no sensor {record.sensor!r} in the header (known: {', '.join(sensors) or 'none'})")
        if isinstance(record, DetectionFrame):
            for index, item in enumerate(record.items):
                _check_detection(item, index, sensor.kind)
        elif isinstance(record, ObjectFrame):
            for index, occluder in enumerate(record.items):
                _check_occluder(occluder, f"items[{index}]")


def _check_odometry(record: Odometry, *, wheelbase_known: bool) -> None:
    _require(math.isfinite(record.speed), "speed", record.speed, "a finite number of m/s")
    turns = [(name, value) for name in ("yaw_rate", "steering") if (value := getattr(record, name)) is not None]
    if len(turns) != 1:
        raise SessionError("odometry needs either yaw_rate or steering")
    name, value = turns[0]
    _require(math.isfinite(value), name, value, "a finite number of radians (per second)")
    if name == "steering" and not wheelbase_known:
        raise SessionError("steering needs wheelbase_m in the header")


def _check_detection(item: Detection, index: int, kind: SensorKind) -> None:
    # names are put together only for what is wrong: this is done for every detection of a drive
    if kind is SensorKind.RANGE_BEARING:
        if item.range is None or not 0.0 < item.range < math.inf:
            raise _wrong(f"items[{index}].range", item.range, "metres above 0")
        if item.bearing is None or not math.isfinite(item.bearing):
            raise _wrong(f"items[{index}].bearing", item.bearing, "radians")
    else:
        if item.x is None or not math.isfinite(item.x):
            raise _wrong(f"items[{index}].x", item.x, "metres")
        if item.y is None or not math.isfinite(item.y):
            raise _wrong(f"items[{index}].y", item.y, "metres")
    if not 0.0 <= item.confidence <= 1.0:
        raise _wrong(f"items[{index}].confidence", item.confidence, "a number in [0, 1]")


def _check_occluder(item: Occluder, field: str) -> None:
    _require(0.0 < item.range < math.inf, f"{field}.range", item.range, "metres above 0")
    _require(math.isfinite(item.bearing), f"{field}.bearing", item.bearing, "radians")
    _require(0.0 <= item.width < math.inf, f"{field}.width", item.width, "metres, at least 0")


def _require(holds: bool, field: str, value: object, expected: str) -> None:
    if not holds:
        raise _wrong(field, value, expected)


def _wrong(field: str, value: object, expected: str) -> SessionError:
    return SessionError(f"{field} must be {expected}, not {value}")
