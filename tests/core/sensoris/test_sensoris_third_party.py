"""A message of somebody else's, without our extension, is used in full."""

import math
from collections.abc import Callable
from datetime import UTC, datetime

import pytest
from google.protobuf.any_pb2 import Any
from google.protobuf.wrappers_pb2 import StringValue

from slamcu_core.reports import DetectionStatus, Health, MapReference
from slamcu_core.sensoris import ThirdPartyDefaults, decode_message
from slamcu_core.sensoris.proto import base_pb2, data_pb2, object_detection_pb2, traffic_regulation_pb2

Message = data_pb2.DataMessage
Sign = traffic_regulation_pb2.TrafficSign
Status = base_pb2.EventDetectionStatus


def sign_of(message: Message) -> Sign:
    return message.event_group[0].traffic_regulation_category.traffic_sign[0]


def lam(weight: float) -> float:
    return 1.0 - math.exp(-weight)


def test_everything_it_says_is_understood(foreign: Message) -> None:
    report = decode_message(foreign)

    (one,) = report.passes
    assert (report.session_id, report.message_id, report.map_identity.version) == ("drive-1", 1, "2026.05.1")
    assert one.started_at == one.ended_at == datetime(2026, 5, 1, 8, 0, 0, 250, tzinfo=UTC)
    assert one.status is DetectionStatus.EXPECTED_AND_DETECTED
    assert lam(one.weight_for) == pytest.approx(0.9, abs=1e-12)
    assert one.weight_against == 0.0
    assert (one.feature_class, one.sign, one.value) == ("traffic_sign", "SPEED_LIMIT", "80")
    assert one.reference == MapReference(12, 4711)
    assert one.position is not None
    assert (one.position.lon, one.position.lat) == (2.1, 48.9)
    assert one.position.covariance_m2 == (2.25, 0.0, 2.25)
    assert (one.frames_detected, one.frames_missed, one.frames_blocked) == (0, 0, 0)
    assert one.valid
    assert report.health == Health()


@pytest.mark.parametrize(
    ("status", "lam_for", "lam_against"),
    [
        (DetectionStatus.EXPECTED_AND_DETECTED, 0.6, 0.0),
        (DetectionStatus.NOT_EXPECTED_AND_DETECTED, 0.6, 0.0),
        (DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE, 0.0, 0.8),
        (DetectionStatus.EXPECTED_AND_NOT_DETECTED, 0.0, 0.4),
        (DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED, 0.0, 0.0),
    ],
)
def test_each_status_takes_its_own_confidence(
    foreign: Message, status: DetectionStatus, lam_for: float, lam_against: float
) -> None:
    sign = sign_of(foreign)
    sign.detection_status.MergeFrom(Status(type=status.value))
    sign.existence_confidence.value = 60
    sign.detection_status.confidence.value = 80

    (one,) = decode_message(foreign, defaults=ThirdPartyDefaults(unexplained_discount=0.5)).passes

    assert one.status is status
    assert lam(one.weight_for) == pytest.approx(lam_for, abs=1e-12)
    assert lam(one.weight_against) == pytest.approx(lam_against, abs=1e-12)


def test_certainty_is_clamped_and_silence_weighs_little(foreign: Message) -> None:
    sign = sign_of(foreign)
    defaults = ThirdPartyDefaults(detected=0.3, not_detected=0.2, unexplained_discount=0.5)

    sign.existence_confidence.value = 100
    assert lam(decode_message(foreign).passes[0].weight_for) == pytest.approx(0.99, abs=1e-12)

    sign.ClearField("existence_confidence")
    assert lam(decode_message(foreign, defaults=defaults).passes[0].weight_for) == pytest.approx(0.3, abs=1e-12)

    sign.detection_status.type = Status.EXPECTED_AND_NOT_DETECTED
    assert lam(decode_message(foreign, defaults=defaults).passes[0].weight_against) == pytest.approx(0.1, abs=1e-12)


def test_a_plain_detection_without_status_is_expected_if_the_map_has_it(foreign: Message) -> None:
    sign_of(foreign).ClearField("detection_status")
    assert decode_message(foreign).passes[0].status is DetectionStatus.EXPECTED_AND_DETECTED

    foreign.ClearField("event_relation")
    assert decode_message(foreign).passes[0].status is DetectionStatus.NOT_EXPECTED_AND_DETECTED


def test_an_invalid_sign_is_not_a_deletion(foreign: Message) -> None:
    sign = sign_of(foreign)
    sign.validation_and_confidence.type = Sign.ValidationAndConfidence.INVALID
    sign.detection_status.type = Status.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE
    sign.detection_status.confidence.value = 95

    (one,) = decode_message(foreign).passes

    assert not one.valid
    assert (one.weight_for, one.weight_against) == (0.0, 0.0)


def test_extensions_and_events_of_others_are_passed_over(foreign: Message) -> None:
    expected = decode_message(foreign)
    stranger = Any()
    stranger.Pack(StringValue(value="?"), type_url_prefix="types.example/")
    unknown = Any(type_url="types.example/example.Unknown", value=b"\xff\xff")
    for extensions in (foreign.envelope.extension, sign_of(foreign).envelope.extension):
        extensions.extend([stranger, unknown])
    pose = foreign.event_group[0].localization_category.vehicle_position_and_orientation.add()
    pose.envelope.id.value = 77

    assert decode_message(foreign) == expected
    # fields of the full schema that the subset leaves out: weather_category (4) and road_attribution_category (7)
    more = foreign.SerializeToString() + b"\x12\x04\x22\x02\x08\x01" + b"\x12\x04\x3a\x02\x08\x01"
    assert decode_message(more) == expected


def test_a_relation_may_name_events_of_categories_outside_the_subset(foreign: Message) -> None:
    relation = foreign.event_relation.add(type=Message.EventRelation.MAP_REFERENCE)
    relation.from_id.add(value=99)
    relation.to_id.add(value=2)
    with_road_events = foreign.SerializeToString() + b"\x12\x04\x3a\x02\x08\x01"

    assert decode_message(with_road_events).passes[0].reference == MapReference(12, 4711)


def test_relations_of_other_types_are_passed_over(foreign: Message) -> None:
    foreign.event_relation.add(type=Message.EventRelation.GROUP).from_id.add(value=1234)

    assert decode_message(foreign).passes[0].reference == MapReference(12, 4711)


def test_a_reference_to_a_link_names_no_object(foreign: Message) -> None:
    place = foreign.event_group[0].map_category.map_reference[0].location_reference
    place.tile_link_offset_reference.link_id.value = 5

    assert decode_message(foreign).passes[0].reference is None


def test_map_versions_by_number_and_sensors_by_source(foreign: Message) -> None:
    version = foreign.envelope.map_identification.provider_version.version
    version.Clear()
    version.major.value, version.minor.value = 2026, 5
    entity = foreign.event_source.add().source.entity
    entity.type.value = "camera-x"
    entity.software_version.name.value = "r7"

    report = decode_message(foreign)

    assert report.map_identity.version == "2026.5"
    assert (report.sensor_model, report.software_version) == ("camera-x", "r7")

    entity.ClearField("type")
    entity.primary_id.value = "serial-4711"
    assert decode_message(foreign).sensor_model == "serial-4711"


def test_signs_that_we_do_not_know_are_not_recognised_and_text_is_a_value(foreign: Message) -> None:
    sign = sign_of(foreign)
    sign.type_and_confidence.MergeFromString(b"\x08\xe7\x07")  # type 999, of a later version of the interface
    assert decode_message(foreign).passes[0].sign is None

    sign.type_and_confidence.type = Sign.TypeAndConfidence.OTHER_AS_TEXT
    sign.type_and_confidence.other_text.value = "Markt"
    sign.ClearField("value_and_confidence")
    (one,) = decode_message(foreign).passes
    assert (one.sign, one.value) == ("OTHER_AS_TEXT", "Markt")


def test_a_pole_as_a_cone_stands_at_its_foot(foreign: Message) -> None:
    thing = foreign.event_group[0].object_detection_category.static_object.add()
    thing.envelope.timestamp.posix_time.value = 1_777_622_400_000
    thing.detection_status.type = Status.NOT_EXPECTED_AND_DETECTED
    thing.type_and_confidence.type = object_detection_pb2.StaticObject.TypeAndConfidence.POLE
    foot = thing.cone_and_accuracy.lower_position_and_accuracy
    foot.geographic_wgs84.longitude.value = 211_000_000
    foot.geographic_wgs84.latitude.value = 4_890_000_000

    pole = next(one for one in decode_message(foreign).passes if one.feature_class == "pole")

    assert pole.position is not None
    assert pole.position.lon == 2.11
    assert pole.position.covariance_m2 == (25.0, 0.0, 25.0)  # no accuracy stated: the default


def test_the_senders_place_is_taken_where_our_extension_has_none(
    a_message: Message, report_of: Callable[..., object]
) -> None:
    from slamcu_core.sensoris.proto import extension_pb2

    event = sign_of(a_message)
    evidence = extension_pb2.PassEvidence.FromString(event.envelope.extension[0].value)
    evidence.ClearField("place")
    event.envelope.extension[0].value = evidence.SerializeToString()

    (one,) = decode_message(a_message).passes

    assert one.position is not None
    assert one.position.lon == pytest.approx(2.1000000123, abs=5.1e-9)
