"""Event ids within a message, and the relations that tie detections to objects of the map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from google.protobuf.unknown_fields import UnknownFieldSet

from slamcu_core.errors import WireError
from slamcu_core.reports import MapReference
from slamcu_core.sensoris.checks import check_reference
from slamcu_core.sensoris.events import Detection
from slamcu_core.sensoris.policy import WireLimits
from slamcu_core.sensoris.proto import base_pb2, data_pb2, map_pb2

_MAP_REFERENCE = data_pb2.DataMessage.EventRelation.MAP_REFERENCE


class EventIds:
    """The events of a message by id; `detections` are those of each of its event groups.

    Raises WireError if there are too many events, an id stands twice or is not positive.
    """

    def __init__(
        self, message: data_pb2.DataMessage, detections: Sequence[Sequence[Detection]], limits: WireLimits
    ) -> None:
        self.known: set[int] = set()
        self.maps: dict[int, map_pb2.MapReference] = {}
        # categories outside our subset hold events too, whose ids we cannot see
        self.complete = not any(_has_unknown_events(group) for group in message.event_group)
        count = 0
        for group, found in zip(message.event_group, detections, strict=True):
            for envelope, reference in _events(group, found):
                count += 1
                if count > limits.max_events:
                    raise WireError("too-many-events", f"more than {limits.max_events} events in one message")
                number = envelope.id.value
                if not number and not envelope.HasField("id"):
                    continue
                if number < 1:
                    raise WireError("bad-event-id", f"an event has the id {number}, expected an integer from 1")
                if number in self.known:
                    raise WireError("duplicate-event-id", f"two events have the id {number}")
                self.known.add(number)
                if reference is not None:
                    self.maps[number] = reference


def map_references(message: data_pb2.DataMessage, ids: EventIds) -> dict[int, MapReference]:
    """Return the map object that each referenced event is about, by event id.

    A reference to an offset on a link names no object, and is passed over.

    Raises WireError where a MAP_REFERENCE relation is empty, names an event that the message does not have, does not
    end at a MapReference event, or gives one event two objects.
    """
    found: dict[int, MapReference] = {}
    for relation in message.event_relation:
        if relation.type != _MAP_REFERENCE:
            continue
        sources, targets = [each.value for each in relation.from_id], [each.value for each in relation.to_id]
        if not sources or not targets:
            raise WireError("bad-reference", "a MAP_REFERENCE relation needs from_id and to_id")
        target = targets[0]
        if len(targets) > 1 and len(set(targets)) > 1:
            raise WireError(
                "ambiguous-reference",
                f"one MAP_REFERENCE relation leads to the events {sorted(set(targets))[:5]}, expected one",
            )
        for number in (*sources, target) if ids.complete else ():
            if number not in ids.known:
                raise WireError(
                    "bad-reference", f"a MAP_REFERENCE relation names event {number}, which is not in the message"
                )
        if target in ids.known and target not in ids.maps:
            raise WireError("bad-reference", f"event {target}, where a MAP_REFERENCE relation ends, is no MapReference")
        reference = _read_reference(ids.maps[target]) if target in ids.maps else None
        if reference is None:
            continue
        for source in sources:
            if found.setdefault(source, reference) != reference:
                raise WireError("ambiguous-reference", f"event {source} refers to two objects of the map")
    return found


def _read_reference(event: map_pb2.MapReference) -> MapReference | None:
    kind = event.location_reference.WhichOneof("map_based_reference")
    if kind is None:
        raise WireError("bad-reference", f"MapReference event {event.envelope.id.value} names neither object nor link")
    if kind != "map_object_id":
        return None
    place = event.location_reference.map_object_id
    check_reference(place.tile_id.value, place.object_id.value)
    return MapReference(place.tile_id.value, place.object_id.value)


def _events(
    group: data_pb2.EventGroup, detections: Sequence[Detection]
) -> Iterator[tuple[base_pb2.EventEnvelope, map_pb2.MapReference | None]]:
    for detection in detections:
        yield detection.envelope, None
    for pose in group.localization_category.vehicle_position_and_orientation:
        yield pose.envelope, None
    for reference in group.map_category.map_reference:
        yield reference.envelope, reference


def _has_unknown_events(group: data_pb2.EventGroup) -> bool:
    parts = (
        group,
        group.localization_category,
        group.object_detection_category,
        group.intersection_attribution_category,
        group.traffic_regulation_category,
        group.map_category,
    )
    return any(len(UnknownFieldSet(part)) > 0 for part in parts)
