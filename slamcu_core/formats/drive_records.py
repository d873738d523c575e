"""The records of a drive log, by their type."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from slamcu_core.catalogue import TRAFFIC_SIGN
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
from slamcu_core.formats.drive_header import HeaderContext
from slamcu_core.formats.fields import Fields
from slamcu_core.formats.labels import read_sign

_DETECTION = Detection(feature_class=TRAFFIC_SIGN)
_OCCLUDER = Occluder(range=0.0, bearing=0.0, width=0.0)


def _read_odometry(fields: Fields, context: HeaderContext) -> Odometry:
    yaw_rate = fields.optional_number("yaw_rate")
    steering = fields.optional_number("steering", above=-math.pi / 2, high=math.pi / 2)
    if yaw_rate is None and steering is None:
        raise fields.place.error("odometry needs yaw_rate or steering", fields.at("yaw_rate"))
    if steering is not None and context.header.wheelbase_m is None:
        raise fields.place.error("steering needs wheelbase_m in the header", fields.at("steering"))
    return Odometry(_time(fields), fields.number("speed"), yaw_rate, steering)


def _read_gnss(fields: Fields, context: HeaderContext) -> GnssFix:
    lon, lat = context.position(fields)
    return GnssFix(_time(fields), lon, lat, fields.number("std_m", above=0.0))


def _read_detections(fields: Fields, context: HeaderContext) -> DetectionFrame:
    sensor = _sensor(fields, context)
    items = tuple(_read_detection(each, sensor) for each in fields.children("items"))
    return DetectionFrame(_time(fields), sensor.id, items)


def _read_detection(fields: Fields, sensor: Sensor) -> Detection:
    feature_class = fields.text("class")
    polar = sensor.kind is SensorKind.RANGE_BEARING
    return Detection(
        feature_class=feature_class,
        range=fields.number("range", above=0.0) if polar else None,
        bearing=_bearing(fields) if polar else None,
        x=None if polar else fields.number("x"),
        y=None if polar else fields.number("y"),
        sign=read_sign(fields, feature_class),
        value=fields.optional_text("value"),
        confidence=fields.number_or("confidence", _DETECTION.confidence, above=0.0, high=1.0),
    )


def _read_objects(fields: Fields, context: HeaderContext) -> ObjectFrame:
    sensor = _sensor(fields, context)
    items = tuple(
        Occluder(
            range=each.number("range", above=0.0),
            bearing=_bearing(each),
            width=each.number("width", low=0.0),
            object_class=each.optional_text("class") or _OCCLUDER.object_class,
        )
        for each in fields.children("items")
    )
    return ObjectFrame(_time(fields), sensor.id, items)


def _time(fields: Fields) -> float:
    return fields.number("t", low=0.0)


def _bearing(fields: Fields) -> float:
    return fields.number("bearing", low=-math.pi, high=math.pi)


def _sensor(fields: Fields, context: HeaderContext) -> Sensor:
    name = fields.text("sensor")
    if name not in context.sensors:
        known = ", ".join(context.sensors) or "none"
        raise fields.error("sensor", f"a sensor of the header ({known})")
    return context.sensors[name]


RECORD_READERS: Mapping[str, Callable[[Fields, HeaderContext], Record]] = {
    "odometry": _read_odometry,
    "gnss": _read_gnss,
    "detections": _read_detections,
    "objects": _read_objects,
}
"""What reads each type of record."""


def record_to_json(record: Record) -> dict[str, object]:
    """Return the JSON object of a record."""
    if isinstance(record, Odometry):
        return {"t": record.t, "type": "odometry", "speed": record.speed} | _present(
            yaw_rate=record.yaw_rate, steering=record.steering
        )
    if isinstance(record, GnssFix):
        return {"t": record.t, "type": "gnss", "lon": record.lon, "lat": record.lat, "std_m": record.std_m}
    if isinstance(record, DetectionFrame):
        items = [_detection_to_json(item) for item in record.items]
        return {"t": record.t, "type": "detections", "sensor": record.sensor, "items": items}
    objects = [
        {"range": item.range, "bearing": item.bearing, "width": item.width, "class": item.object_class}
        for item in record.items
    ]
    return {"t": record.t, "type": "objects", "sensor": record.sensor, "items": objects}


def _detection_to_json(item: Detection) -> dict[str, object]:
    place = _present(range=item.range, bearing=item.bearing, x=item.x, y=item.y)
    label: dict[str, object] = {"class": item.feature_class}
    return place | label | _present(sign=item.sign, value=item.value) | {"confidence": item.confidence}


def _present(**values: object) -> dict[str, object]:
    return {name: value for name, value in values.items() if value is not None}
