"""Every message that cannot be used is refused with a stable reason and a text that says what was expected."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest

from slamcu_core.errors import WireError
from slamcu_core.reports import DetectionStatus, Health, MapReference, MeasuredPosition, PassReport, ReportMessage
from slamcu_core.sensoris import WireLimits, decode_message, encode_message, sendable
from slamcu_core.sensoris.extension import find, pack
from slamcu_core.sensoris.proto import base_pb2, data_pb2, extension_pb2, spatial_pb2, traffic_regulation_pb2

Message = data_pb2.DataMessage
Evidence = extension_pb2.PassEvidence
Status = base_pb2.EventDetectionStatus


def sign_of(message: Message) -> traffic_regulation_pb2.TrafficSign:
    return message.event_group[0].traffic_regulation_category.traffic_sign[0]


def place_of(message: Message) -> spatial_pb2.PositionAndAccuracy:
    return sign_of(message).rectangular_box_and_accuracy.center_orientation_size.center_position_and_accuracy


def longitude(message: Message) -> None:
    place_of(message).geographic_wgs84.longitude.value = 18_000_000_001


def mars(message: Message) -> None:
    place_of(message).geographic_wgs84.altitude.value = 225_000_000_000_000


def far_from_origin(message: Message) -> None:
    message.event_group[0].envelope.origin.position_and_accuracy.geographic_wgs84.longitude.value = 0
    message.event_group[0].envelope.origin.position_and_accuracy.geographic_wgs84.latitude.value = 0
    place_of(message).metric_event_group.x.value = 2**62
    place_of(message).metric_event_group.y.value = 0


def no_origin(message: Message) -> None:
    place_of(message).metric_event_group.x.value = 1
    place_of(message).metric_event_group.y.value = 1


def no_pose(message: Message) -> None:
    place_of(message).metric_vehicle.x.value = 1
    place_of(message).metric_vehicle.y.value = 1


def earth_centred(message: Message) -> None:
    place_of(message).metric_ecef.x.value = 1


def half_a_place(message: Message) -> None:
    place_of(message).geographic_wgs84.ClearField("latitude")


def not_positive_definite(message: Message) -> None:
    covariance = place_of(message).covariance
    covariance.a11.value = covariance.a22.value = 100
    covariance.a12.value = covariance.a21.value = 100


def not_symmetric(message: Message) -> None:
    covariance = place_of(message).covariance
    covariance.a11.value = covariance.a22.value = 100
    covariance.a12.value = 5


def hopelessly_vague(message: Message) -> None:
    place_of(message).combined_std_dev.value = 1_000_000


def negative_std(message: Message) -> None:
    place_of(message).std_dev.horizontal.value = -1


def no_timestamp(message: Message) -> None:
    sign_of(message).envelope.ClearField("timestamp")


def far_future(message: Message) -> None:
    sign_of(message).envelope.timestamp.posix_time.value = 2**62


def last_century(message: Message) -> None:
    sign_of(message).envelope.timestamp.posix_time.value = 0


def odd_fraction(message: Message) -> None:
    sign_of(message).envelope.timestamp.posix_time_fraction.value = 1000


def no_session(message: Message) -> None:
    message.envelope.ids.session_id.value = ""


def no_message_id(message: Message) -> None:
    message.envelope.ids.ClearField("message_id")


def negative_message_id(message: Message) -> None:
    message.envelope.ids.message_id.value = -1


def control_character(message: Message) -> None:
    message.envelope.ids.session_id.value = "a\x00b"


def endless_name(message: Message) -> None:
    message.envelope.ids.vehicle_id.value = "x" * 201


def zero_confidence(message: Message) -> None:
    sign_of(message).existence_confidence.value = 0


def too_confident(message: Message) -> None:
    sign_of(message).existence_confidence.value = 101


def too_confident_that_it_is_gone(message: Message) -> None:
    sign_of(message).detection_status.type = Status.EXPECTED_AND_NOT_DETECTED
    sign_of(message).detection_status.confidence.value = 101


def says_nothing(message: Message) -> None:
    sign_of(message).ClearField("detection_status")
    sign_of(message).ClearField("existence_confidence")
    sign_of(message).ClearField("rectangular_box_and_accuracy")


def status_of_the_future(message: Message) -> None:
    sign_of(message).detection_status.MergeFromString(b"\x08\x09")


def nowhere(message: Message) -> None:
    sign_of(message).detection_status.type = Status.NOT_EXPECTED_AND_DETECTED
    sign_of(message).ClearField("rectangular_box_and_accuracy")


def no_object_id(message: Message) -> None:
    message.event_group[0].map_category.map_reference[0].location_reference.map_object_id.object_id.value = 0


def reference_to_nothing(message: Message) -> None:
    message.event_group[0].map_category.map_reference[0].ClearField("location_reference")


def unknown_target(message: Message) -> None:
    message.event_relation[0].to_id[0].value = 9


def unknown_source(message: Message) -> None:
    message.event_relation[0].from_id.add(value=9)


def target_is_no_reference(message: Message) -> None:
    message.event_relation[0].to_id[0].value = 1


def relation_without_end(message: Message) -> None:
    message.event_relation[0].ClearField("to_id")


def two_targets(message: Message) -> None:
    second = message.event_group[0].map_category.map_reference.add()
    second.envelope.id.value = 3
    second.location_reference.map_object_id.object_id.value = 5
    message.event_relation[0].to_id.add(value=3)


def two_relations(message: Message) -> None:
    two_targets(message)
    del message.event_relation[0].to_id[1]
    relation = message.event_relation.add(type=Message.EventRelation.MAP_REFERENCE)
    relation.from_id.add(value=1)
    relation.to_id.add(value=3)


def duplicate_id(message: Message) -> None:
    message.event_group[0].map_category.map_reference[0].envelope.id.value = 1


def zero_id(message: Message) -> None:
    sign_of(message).envelope.id.value = 0


def other_resolution(message: Message) -> None:
    message.envelope.field_resolution_override.add().exponent.value = 2


REFUSED = [
    ("position-out-of-range", longitude),
    ("position-out-of-range", mars),
    ("position-out-of-range", far_from_origin),
    ("unresolvable-position", no_origin),
    ("unresolvable-position", no_pose),
    ("unresolvable-position", earth_centred),
    ("unresolvable-position", half_a_place),
    ("bad-covariance", not_positive_definite),
    ("bad-covariance", not_symmetric),
    ("bad-covariance", hopelessly_vague),
    ("bad-covariance", negative_std),
    ("bad-time", no_timestamp),
    ("bad-time", far_future),
    ("bad-time", last_century),
    ("bad-time", odd_fraction),
    ("missing-ids", no_session),
    ("missing-ids", no_message_id),
    ("missing-ids", negative_message_id),
    ("bad-text", control_character),
    ("bad-text", endless_name),
    ("bad-confidence", zero_confidence),
    ("bad-confidence", too_confident),
    ("bad-confidence", too_confident_that_it_is_gone),
    ("missing-status", says_nothing),
    ("missing-status", status_of_the_future),
    ("missing-position", nowhere),
    ("bad-reference", no_object_id),
    ("bad-reference", reference_to_nothing),
    ("bad-reference", unknown_target),
    ("bad-reference", unknown_source),
    ("bad-reference", target_is_no_reference),
    ("bad-reference", relation_without_end),
    ("ambiguous-reference", two_targets),
    ("ambiguous-reference", two_relations),
    ("duplicate-event-id", duplicate_id),
    ("bad-event-id", zero_id),
    ("unsupported-resolution", other_resolution),
]


@pytest.mark.parametrize(("reason", "spoil"), REFUSED, ids=lambda value: getattr(value, "__name__", value))
def test_a_message_with_one_fault_is_refused_by_name(
    foreign: Message, reason: str, spoil: Callable[[Message], None]
) -> None:
    decode_message(foreign)
    spoil(foreign)

    with pytest.raises(WireError) as refusal:
        decode_message(foreign)

    assert refusal.value.reason == reason
    assert len(refusal.value.message) > 20


def test_a_fault_in_an_event_names_the_event(foreign: Message) -> None:
    too_confident(foreign)

    with pytest.raises(WireError, match=r"traffic_sign, event id 1: existence_confidence is 101, expected 1 to 100"):
        decode_message(foreign)


def test_too_many_events_are_refused(foreign: Message) -> None:
    with pytest.raises(WireError) as refusal:
        decode_message(foreign, limits=WireLimits(max_events=1))

    assert refusal.value.reason == "too-many-events"


def test_a_receiver_with_a_clock_refuses_the_future(foreign: Message) -> None:
    now = datetime(2026, 4, 30, tzinfo=UTC)

    with pytest.raises(WireError) as refusal:
        decode_message(foreign, limits=WireLimits(latest=now))

    assert refusal.value.reason == "bad-time"


@pytest.mark.parametrize("body", [b"\xff\xff\xff", b"\x0a", b"hello world", b"\x12\x05abc"])
def test_bytes_that_are_no_message_are_refused(body: bytes) -> None:
    with pytest.raises(WireError) as refusal:
        decode_message(body)

    assert refusal.value.reason in ("not-protobuf", "missing-ids")


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("bad-weight", {"weight_for": math.nan}),
        ("bad-weight", {"weight_for": math.inf}),
        ("bad-weight", {"weight_for": -0.1}),
        ("bad-weight", {"weight_against": 1000.1}),
        ("contradiction", {"weight_for": 0.0, "weight_against": 1.0}),
        ("contradiction", {"ended_at": 1_600_000_000_000_000, "started_at": 1_600_000_000_000_000}),
        ("contradiction", {"started_at": 1_900_000_000_000_000}),
        ("bad-time", {"ended_at": 2**62}),
        ("bad-count", {"frames_missed": 2**32 - 1}),
        ("contradiction", {"longitude": 2.2}),
        ("contradiction", {"latitude": math.nan}),
        ("bad-covariance", {"covariance": 5.0}),
        ("bad-covariance", {"variance_east": math.inf}),
        ("bad-covariance", {"variance_north": -1.0}),
    ],
)
def test_the_extension_is_checked_like_all_else(
    a_message: Message, reason: str, changes: dict[str, float | int]
) -> None:
    event = sign_of(a_message)
    evidence = find(event.envelope.extension, Evidence)
    assert evidence is not None
    for name, value in changes.items():
        holder = evidence if name in Evidence.DESCRIPTOR.fields_by_name else evidence.place
        setattr(holder, name, value)
    event.envelope.extension[0].CopyFrom(pack(evidence))

    with pytest.raises(WireError) as refusal:
        decode_message(a_message)

    assert refusal.value.reason == reason


def test_an_extension_twice_or_torn_is_refused(a_message: Message) -> None:
    extensions = sign_of(a_message).envelope.extension
    extensions.append(extensions[0])
    with pytest.raises(WireError) as twice:
        decode_message(a_message)

    del extensions[1]
    extensions[0].value = extensions[0].value[:-1]
    with pytest.raises(WireError) as torn:
        decode_message(a_message)

    assert (twice.value.reason, torn.value.reason) == ("bad-extension", "bad-extension")


def test_the_extension_may_not_say_seen_where_the_status_says_not(a_message: Message) -> None:
    event = sign_of(a_message)
    event.envelope.extension[0].CopyFrom(pack(replace_evidence(event, weight_for=3.0, weight_against=0.0)))
    event.detection_status.type = Status.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE
    with pytest.raises(WireError) as missed:
        decode_message(a_message)

    event.detection_status.type = Status.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED
    with pytest.raises(WireError) as blocked:
        decode_message(a_message)

    assert (missed.value.reason, blocked.value.reason) == ("contradiction", "contradiction")


def replace_evidence(event: traffic_regulation_pb2.TrafficSign, **changes: float) -> Evidence:
    evidence = find(event.envelope.extension, Evidence)
    assert evidence is not None
    for name, value in changes.items():
        setattr(evidence, name, value)
    return evidence


@pytest.mark.parametrize(
    "health",
    [
        Health(effective_particles=0.0),
        Health(effective_particles=math.nan),
        Health(innovation_ratio=math.inf),
        Health(unexplained_ratio=1.1),
        Health(unexplained_ratio=-0.1),
    ],
)
def test_impossible_health_is_refused(a_report: ReportMessage, health: Health) -> None:
    with pytest.raises(WireError) as refusal:
        encode_message(replace(a_report, health=health))

    assert refusal.value.reason == "bad-health"


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("unknown-class", {"feature_class": "ufo"}),
        ("unknown-sign", {"sign": "SPEED_LIMITS"}),
        ("unknown-sign", {"sign": "UNKNOWN_TYPE"}),
        ("bad-text", {"value": "8\n0"}),
        ("bad-time", {"started_at": datetime(2026, 5, 1)}),  # noqa: DTZ001 - the point of the case
        ("bad-time", {"ended_at": datetime(2026, 5, 1, 7, tzinfo=UTC)}),
        ("bad-weight", {"weight_for": math.nan}),
        ("bad-count", {"frames_blocked": -1}),
        ("missing-position", {"position": None, "reference": None}),
        ("missing-position", {"position": None, "status": DetectionStatus.NOT_EXPECTED_AND_DETECTED}),
        ("bad-reference", {"reference": MapReference(0, 0)}),
        ("bad-reference", {"reference": MapReference(2**63, 1)}),
        ("position-out-of-range", {"position": MeasuredPosition(2.0, math.nan, (1.0, 0.0, 1.0))}),
        ("bad-covariance", {"position": MeasuredPosition(2.0, 48.0, (1.0, 1.0, 1.0))}),
        ("contradiction", {"weight_for": 0.0}),
    ],
)
def test_what_would_be_refused_is_not_sent(
    report_of: Callable[..., ReportMessage], reason: str, changes: dict[str, object]
) -> None:
    report = report_of(**changes)

    with pytest.raises(WireError, match="pass 0: ") as sending:
        encode_message(report)
    with pytest.raises(WireError) as checking:
        sendable(report.passes[0])

    assert sending.value.reason == checking.value.reason == reason


@pytest.mark.parametrize("side", ["for", "against"])
def test_a_weight_out_of_range_is_named_by_its_side(report_of: Callable[..., ReportMessage], side: str) -> None:
    with pytest.raises(WireError, match=f"the evidence {side} weighs -1, expected 0 to 1000"):
        sendable(report_of(**{f"weight_{side}": -1.0}).passes[0])


def test_a_sound_pass_passes_the_check(a_pass: PassReport) -> None:
    sendable(a_pass)
    sendable(replace(a_pass, ended_at=a_pass.started_at, started_at=a_pass.started_at - timedelta(days=3)))
    here = timezone(timedelta(hours=2))
    sendable(replace(a_pass, started_at=a_pass.started_at.astimezone(here), ended_at=a_pass.ended_at.astimezone(here)))


def test_every_reason_is_documented() -> None:
    root = Path(__file__).parents[3]
    code = "".join(path.read_text() for path in (root / "slamcu_core" / "sensoris").glob("*.py"))
    raised = set(re.findall(r'WireError\(\s*"([a-z-]+)"', code))
    section = (root / "docs" / "sensoris.md").read_text().split("## Refusals")[1]
    documented = {
        reason
        for line in section.splitlines()
        if line.startswith("| `")
        for reason in re.findall(r"`([a-z-]+)`", line.split("|")[1])
    }

    assert raised == documented
