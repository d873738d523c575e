"""From reports to SENSORIS messages."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import Health, MapReference, PassReport, ReportMessage
from slamcu_core.sensoris.checks import DETECTED, NOT_DETECTED, check_message, check_pass
from slamcu_core.sensoris.events import Event, add_event, carries_sign
from slamcu_core.sensoris.extension import TYPE_URLS, pack
from slamcu_core.sensoris.policy import MAX_PASS_WEIGHT
from slamcu_core.sensoris.position import write_position
from slamcu_core.sensoris.proto import base_pb2, data_pb2, extension_pb2
from slamcu_core.sensoris.times import to_microseconds, write_timestamp
from slamcu_core.sensoris.wire import delimited

SENSORIS_VERSION = (1, 5, 1)


def sendable(report: PassReport) -> PassReport:
    """Return a pass as it is sent.

    Weights above MAX_PASS_WEIGHT are lowered by the same amount each, which keeps their ratio of masses: some minutes
    before a red light gather so much. A sign that is not valid (crossed out) carries no evidence against.

    Raises WireError if a receiver would refuse the pass.
    """
    report = _bounded(report)
    check_pass(report)
    return report


def encode_message(report: ReportMessage) -> data_pb2.DataMessage:
    """Turn a report into a SENSORIS DataMessage: its fields for any receiver, exact evidence in our extension.

    Each pass is sent as `sendable` has it. Raises WireError if a receiver would refuse the report.
    """
    report = replace(report, passes=tuple(_bounded(one) for one in report.passes))
    check_message(report)
    message = data_pb2.DataMessage()
    _write_envelope(message.envelope, report)
    if not report.passes:
        return message
    group = message.event_group.add()
    references: dict[MapReference, int] = {}
    for event_id, one in enumerate(report.passes, start=1):
        event, box = add_event(group, one)
        event.envelope.id.value = event_id
        _write_event(event, one)
        if one.position is not None:
            write_position(box.center_orientation_size.center_position_and_accuracy, one.position)
        if one.reference is not None:
            target = references.setdefault(one.reference, len(report.passes) + 1 + len(references))
            relation = message.event_relation.add(type=data_pb2.DataMessage.EventRelation.MAP_REFERENCE)
            relation.from_id.add(value=event_id)
            relation.to_id.add(value=target)
    for reference, event_id in references.items():
        target_event = group.map_category.map_reference.add()
        target_event.envelope.id.value = event_id
        target_event.location_reference.map_object_id.tile_id.value = reference.tile_id
        target_event.location_reference.map_object_id.object_id.value = reference.object_id
    return message


def _bounded(report: PassReport) -> PassReport:
    f, a = report.weight_for, report.weight_against if report.valid else 0.0
    excess = max(f, a) - MAX_PASS_WEIGHT
    if math.isfinite(excess) and excess > 0.0:
        f, a = max(f - excess, 0.0), max(a - excess, 0.0)
    return replace(report, weight_for=f, weight_against=a, sign=report.sign or None, value=report.value or None)


def serialize_message(report: ReportMessage) -> bytes:
    """Return the bytes of a report's DataMessage: the same bytes for the same report, as idempotency needs."""
    return encode_message(report).SerializeToString(deterministic=True)


def join_batch(messages: Iterable[bytes]) -> bytes:
    """Return the body of a DataMessages batch out of serialized DataMessages, whose bytes are kept as they are."""
    head = data_pb2.DataMessages.Envelope()
    for part, number in zip(("major", "minor", "patch"), SENSORIS_VERSION, strict=True):
        getattr(head.version, part).value = number
    for url in TYPE_URLS:
        head.extension_type_url_and_version.add().type_url.type_url.value = url
    fields = data_pb2.DataMessages
    return delimited(fields.ENVELOPE_FIELD_NUMBER, head.SerializeToString(deterministic=True)) + b"".join(
        delimited(fields.DATA_MESSAGE_FIELD_NUMBER, message) for message in messages
    )


def encode_batch(reports: Iterable[ReportMessage]) -> bytes:
    """Return the body of a DataMessages batch of reports. Raises WireError as `encode_message` does."""
    return join_batch(serialize_message(report) for report in reports)


def _write_envelope(envelope: data_pb2.DataMessage.Envelope, report: ReportMessage) -> None:
    ids = envelope.ids
    ids.session_id.value = report.session_id
    ids.message_id.value = report.message_id
    ids.last_message_of_session.value = report.last_of_session
    if report.fleet_id:
        ids.vehicle_fleet_id.value = report.fleet_id
    if report.vehicle_id:
        ids.vehicle_id.value = report.vehicle_id
    if report.map_identity != MapIdentity():
        provider = envelope.map_identification.provider_version
        provider.source.value = report.map_identity.source
        provider.version.name.value = report.map_identity.version
    health: Health = report.health
    envelope.extension.append(
        pack(
            extension_pb2.MessageHealth(
                trusted=health.trusted,
                effective_particles=health.effective_particles,
                innovation_ratio=health.innovation_ratio,
                unexplained_ratio=health.unexplained_ratio,
                sensor_model=report.sensor_model,
                software_version=report.software_version,
            )
        )
    )


def _write_event(event: Event, report: PassReport) -> None:
    write_timestamp(event.envelope.timestamp, report.ended_at)
    event.envelope.extension.append(pack(_evidence(report)))
    event.detection_status.MergeFrom(base_pb2.EventDetectionStatus(type=report.status.value))
    # what a receiver without our extension takes for λ: the net evidence of the pass as one simple support
    net = report.weight_for - report.weight_against
    if report.status in DETECTED:
        event.existence_confidence.value = _per_cent(net)
    elif report.status in NOT_DETECTED:
        event.detection_status.confidence.value = _per_cent(-net)


def _per_cent(weight: float) -> int:
    """Return λ = 1 - exp(-weight) in whole per cent, 1 to 99: 0 is not legal, and 100 is dogma."""
    return min(99, max(1, round(-100.0 * math.expm1(-max(weight, 0.0)))))


def _evidence(report: PassReport) -> extension_pb2.PassEvidence:
    evidence = extension_pb2.PassEvidence(
        weight_for=report.weight_for,
        weight_against=report.weight_against,
        started_at=to_microseconds(report.started_at),
        ended_at=to_microseconds(report.ended_at),
        frames_detected=report.frames_detected,
        frames_missed=report.frames_missed,
        frames_blocked=report.frames_blocked,
        invalid=not report.valid,
    )
    if not carries_sign(report.feature_class):
        evidence.sign, evidence.value = report.sign or "", report.value or ""
    if report.position is not None:
        place = evidence.place
        place.longitude, place.latitude = report.position.lon, report.position.lat
        place.variance_east, place.covariance, place.variance_north = report.position.covariance_m2
    return evidence
