"""Which SENSORIS event stands for which class of feature, and the fields that these events share.

traffic sign: TrafficRegulationCategory.traffic_sign; traffic light: IntersectionAttributionCategory.traffic_signal;
all else: ObjectDetectionCategory.static_object.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from slamcu_core.catalogue import STATIC_OBJECT, TRAFFIC_LIGHT, TRAFFIC_SIGN
from slamcu_core.reports import PassReport
from slamcu_core.sensoris.proto import (
    base_pb2,
    data_pb2,
    intersection_attribution_pb2,
    object_detection_pb2,
    spatial_pb2,
    traffic_regulation_pb2,
)

TrafficSign = traffic_regulation_pb2.TrafficSign
StaticObject = object_detection_pb2.StaticObject
Event = (
    traffic_regulation_pb2.TrafficSign | intersection_attribution_pb2.TrafficSignal | object_detection_pb2.StaticObject
)

_INVALID = TrafficSign.ValidationAndConfidence.INVALID
# a number that a later version of the interface adds is in neither: a sign that we do not recognise, a thing of no kind
_SIGNS: dict[int, str] = {n: name for name, n in TrafficSign.TypeAndConfidence.Type.items() if n}
_STATIC_CLASSES: dict[int, str] = {n: name.lower() for name, n in StaticObject.TypeAndConfidence.Type.items() if n}


class Detection(NamedTuple):
    """One detection event, whatever its class."""

    event: Event
    envelope: base_pb2.EventEnvelope
    feature_class: str
    sign: str | None
    value: str | None
    valid: bool
    place: spatial_pb2.PositionAndAccuracy | None


def detections(group: data_pb2.EventGroup) -> Iterator[Detection]:
    """Iterate over the detections of point features in an event group."""
    for sign in group.traffic_regulation_category.traffic_sign:
        yield Detection(
            sign,
            sign.envelope,
            TRAFFIC_SIGN,
            _SIGNS.get(sign.type_and_confidence.type),
            _sign_value(sign),
            sign.validation_and_confidence.type != _INVALID,
            _center(sign.rectangular_box_and_accuracy),
        )
    for signal in group.intersection_attribution_category.traffic_signal:
        place = _center(signal.rectangular_box_and_accuracy)
        yield Detection(signal, signal.envelope, TRAFFIC_LIGHT, None, None, True, place)
    for thing in group.object_detection_category.static_object:
        yield Detection(
            thing,
            thing.envelope,
            _STATIC_CLASSES.get(thing.type_and_confidence.type, STATIC_OBJECT),
            None,
            None,
            True,
            _static_place(thing),
        )


def add_event(group: data_pb2.EventGroup, report: PassReport) -> tuple[Event, spatial_pb2.RectangularBoxAndAccuracy]:
    """Add the event that stands for a report's feature; return it and the box whose centre is its place."""
    event: Event
    if report.feature_class == TRAFFIC_SIGN:
        event = group.traffic_regulation_category.traffic_sign.add()
        if report.sign is not None:
            event.type_and_confidence.MergeFrom(TrafficSign.TypeAndConfidence(type=report.sign))
        if report.value:
            event.value_and_confidence.value.value = report.value
        if not report.valid:
            event.validation_and_confidence.type = _INVALID
    elif report.feature_class == TRAFFIC_LIGHT:
        event = group.intersection_attribution_category.traffic_signal.add()
    else:
        event = group.object_detection_category.static_object.add()
        if report.feature_class != STATIC_OBJECT:
            event.type_and_confidence.MergeFrom(StaticObject.TypeAndConfidence(type=report.feature_class.upper()))
    return event, event.rectangular_box_and_accuracy


def carries_sign(feature_class: str) -> bool:
    """Say whether the SENSORIS event of a class has a place for a sign's type and value."""
    return feature_class == TRAFFIC_SIGN


def _sign_value(sign: traffic_regulation_pb2.TrafficSign) -> str | None:
    # a sign given as text says there what others say in the value
    return sign.value_and_confidence.value.value or sign.type_and_confidence.other_text.value or None


def _center(box: spatial_pb2.RectangularBoxAndAccuracy) -> spatial_pb2.PositionAndAccuracy | None:
    center = box.center_orientation_size
    return center.center_position_and_accuracy if center.HasField("center_position_and_accuracy") else None


def _static_place(thing: object_detection_pb2.StaticObject) -> spatial_pb2.PositionAndAccuracy | None:
    if thing.WhichOneof("geometry") == "cone_and_accuracy":
        cone = thing.cone_and_accuracy
        return cone.lower_position_and_accuracy if cone.HasField("lower_position_and_accuracy") else None
    return _center(thing.rectangular_box_and_accuracy)
