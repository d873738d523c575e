"""The header of a drive log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import partial

import numpy as np

from slamcu_core.drive import DriveHeader, InitialPose, Mount, Sensor, SensorKind
from slamcu_core.formats.fields import Fields
from slamcu_core.geometry import LocalFrame

FORMAT = "slamcu-drive-log"
VERSION = 1

_SENSOR = Sensor(id="default")
_POSE = InitialPose(lon=0.0, lat=0.0, heading_deg=0.0)


@dataclass(frozen=True)
class HeaderContext:
    """What the header says that its records are read with."""

    header: DriveHeader
    position: Callable[[Fields], tuple[float, float]]  # of a record or pose, to longitude and latitude
    sensors: dict[str, Sensor]


def read_header(fields: Fields) -> HeaderContext:
    """Read the first line of a drive log. Raises FormatError."""
    if fields.data.get("type") != "header":
        raise fields.error("type", '"header" on the first line of a drive log')
    if fields.data.get("format") != FORMAT:
        raise fields.error("format", f'"{FORMAT}"')
    if fields.integer("version") != VERSION:
        raise fields.error("version", f"{VERSION}, the only version there is")
    position = _position_reader(fields)
    sensors: dict[str, Sensor] = {}
    for each in fields.children("sensors"):
        sensor = _read_sensor(each)
        if sensor.id in sensors:
            raise each.place.error(f"two sensors have the id {sensor.id!r}", each.at("id"))
        sensors[sensor.id] = sensor
    pose = _read_pose(fields.child("initial_pose"), position)
    make = partial(
        DriveHeader,
        vehicle_id=fields.text("vehicle_id"),
        session_id=fields.text("session_id"),
        start_time=_read_time(fields, "start_time"),
        initial_pose=pose,
        sensors=tuple(sensors.values()),
        fleet_id=fields.optional_text("fleet_id") or "",
        wheelbase_m=fields.optional_number("wheelbase_m", above=0.0),
    )
    return HeaderContext(fields.checked(make), position, sensors)


def header_to_json(header: DriveHeader) -> dict[str, object]:
    """Return the JSON object of a header."""
    pose = header.initial_pose
    document: dict[str, object] = {
        "type": "header",
        "format": FORMAT,
        "version": VERSION,
        "vehicle_id": header.vehicle_id,
        "session_id": header.session_id,
        "start_time": header.start_time.isoformat(),
        "frame": "wgs84",
        "initial_pose": {
            "lon": pose.lon,
            "lat": pose.lat,
            "heading_deg": pose.heading_deg,
            "position_std_m": pose.position_std_m,
            "heading_std_deg": pose.heading_std_deg,
        },
        "sensors": [_sensor_to_json(sensor) for sensor in header.sensors],
    }
    if header.fleet_id:
        document["fleet_id"] = header.fleet_id
    if header.wheelbase_m is not None:
        document["wheelbase_m"] = header.wheelbase_m
    return document


def _position_reader(fields: Fields) -> Callable[[Fields], tuple[float, float]]:
    """Return what reads a position in the frame that the header names."""
    if fields.data.get("frame", "wgs84") == "wgs84":
        return _read_lonlat
    frame = fields.data.get("frame")
    if not isinstance(frame, dict) or "local" not in frame:
        raise fields.error("frame", '"wgs84" or {"local": {"lon": …, "lat": …, "heading_deg": …}}')
    local = fields.child("frame").child("local")
    lon, lat = _read_lonlat(local)
    anchor = LocalFrame(lon, lat)
    axis = np.deg2rad(90.0 - local.number("heading_deg", low=-360.0, high=360.0))
    c, s = float(np.cos(axis)), float(np.sin(axis))

    def read(position: Fields) -> tuple[float, float]:
        x = position.number("x", low=-1e5, high=1e5)
        y = position.number("y", low=-1e5, high=1e5)
        lon, lat = anchor.to_geographic((c * x - s * y, s * x + c * y))
        return float(lon), float(lat)

    return read


def _read_lonlat(fields: Fields) -> tuple[float, float]:
    return fields.number("lon", low=-180.0, high=180.0), fields.number("lat", low=-90.0, high=90.0)


def _read_time(fields: Fields, name: str) -> datetime:
    try:
        instant = datetime.fromisoformat(fields.text(name))
    except ValueError:
        instant = None
    if instant is None or instant.tzinfo is None:
        raise fields.error(name, 'an ISO 8601 time with a time zone, such as "2026-05-01T08:00:00Z"')
    return instant


def _read_pose(fields: Fields, position: Callable[[Fields], tuple[float, float]]) -> InitialPose:
    lon, lat = position(fields)
    make = partial(
        InitialPose,
        lon,
        lat,
        heading_deg=fields.number("heading_deg"),
        position_std_m=fields.number_or("position_std_m", _POSE.position_std_m),
        heading_std_deg=fields.number_or("heading_std_deg", _POSE.heading_std_deg),
    )
    return fields.checked(make)


def _read_sensor(fields: Fields) -> Sensor:
    min_range_m = fields.number_or("min_range_m", _SENSOR.min_range_m)
    make = partial(
        Sensor,
        id=fields.text("id"),
        kind=SensorKind(fields.text("kind", choices=list(SensorKind))) if "kind" in fields else _SENSOR.kind,
        fov_deg=fields.number_or("fov_deg", _SENSOR.fov_deg),
        min_range_m=min_range_m,
        max_range_m=fields.number_or("max_range_m", max(_SENSOR.max_range_m, min_range_m + 1.0)),
        rate_hz=fields.number_or("rate_hz", _SENSOR.rate_hz),
        mount=_read_mount(fields.child("mount")) if "mount" in fields else _SENSOR.mount,
        range_std_m=fields.number_or("range_std_m", _SENSOR.range_std_m),
        range_std_rel=fields.number_or("range_std_rel", _SENSOR.range_std_rel),
        bearing_std_rad=fields.number_or("bearing_std_rad", _SENSOR.bearing_std_rad),
        position_std_m=fields.number_or("position_std_m", _SENSOR.position_std_m),
        detection_probability=fields.number_or("detection_probability", _SENSOR.detection_probability),
        false_alarms_per_frame=fields.number_or("false_alarms_per_frame", _SENSOR.false_alarms_per_frame),
        classes=fields.texts("classes") if "classes" in fields else _SENSOR.classes,
    )
    return fields.checked(make)


def _read_mount(fields: Fields) -> Mount:
    numbers = [fields.number_or(name, getattr(_SENSOR.mount, name)) for name in ("x", "y", "yaw_deg")]
    return fields.checked(partial(Mount, *numbers))


def _sensor_to_json(sensor: Sensor) -> dict[str, object]:
    return {
        "id": sensor.id,
        "kind": sensor.kind.value,
        "fov_deg": sensor.fov_deg,
        "min_range_m": sensor.min_range_m,
        "max_range_m": sensor.max_range_m,
        "rate_hz": sensor.rate_hz,
        "mount": {"x": sensor.mount.x, "y": sensor.mount.y, "yaw_deg": sensor.mount.yaw_deg},
        "range_std_m": sensor.range_std_m,
        "range_std_rel": sensor.range_std_rel,
        "bearing_std_rad": sensor.bearing_std_rad,
        "position_std_m": sensor.position_std_m,
        "detection_probability": sensor.detection_probability,
        "false_alarms_per_frame": sensor.false_alarms_per_frame,
        "classes": list(sensor.classes),
    }
