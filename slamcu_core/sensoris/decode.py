"""From SENSORIS messages to reports, whether they carry our extension or not."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta

from google.protobuf.message import DecodeError

from slamcu_core.errors import WireError
from slamcu_core.reports import MapReference, MeasuredPosition, PassReport, ReportMessage
from slamcu_core.sensoris.checks import check_message
from slamcu_core.sensoris.envelope import read_envelope
from slamcu_core.sensoris.events import Detection, carries_sign, detections
from slamcu_core.sensoris.evidence import Evidence, read_evidence, read_status
from slamcu_core.sensoris.policy import DEFAULT_LIMITS, DEFAULT_THIRD_PARTY, ThirdPartyDefaults, WireLimits
from slamcu_core.sensoris.position import PositionReader
from slamcu_core.sensoris.proto import data_pb2
from slamcu_core.sensoris.relations import EventIds, map_references
from slamcu_core.sensoris.times import read_timestamp

_TIME_TOLERANCE = timedelta(milliseconds=1)
_PLACE_TOLERANCE_DEG = 1e-6  # 0.1 m: SENSORIS has 1e-8, others may round more


def decode_message(
    message: data_pb2.DataMessage | bytes,
    *,
    limits: WireLimits = DEFAULT_LIMITS,
    defaults: ThirdPartyDefaults = DEFAULT_THIRD_PARTY,
) -> ReportMessage:
    """Turn a DataMessage, parsed or serialized, into a report; its passes stand in the order of their event ids.

    Where our extension is present its numbers are taken, after a check that they say the same as the SENSORIS fields.
    Where it is not, λ is existence_confidence (detected) or detection_status.confidence (not detected), 100 % clamped
    to 0.99, and the pass starts and ends at the event's timestamp. Events of other kinds are passed over.

    Raises WireError, and nothing else, where the message cannot be used: it is taken whole or refused whole.
    """
    if isinstance(message, bytes):
        try:
            message = data_pb2.DataMessage.FromString(message)
        except DecodeError as error:
            raise WireError("not-protobuf", "the bytes are not a serialized SENSORIS DataMessage") from error
    report = read_envelope(message)
    found = [tuple(detections(group)) for group in message.event_group]
    ids = EventIds(message, found, limits)
    references = map_references(message, ids)
    passes: list[tuple[int, PassReport]] = []
    for group, mine in zip(message.event_group, found, strict=True):
        positions = PositionReader(group, limits, defaults)
        for detection in mine:
            number = detection.envelope.id.value
            try:
                passes.append((number, _read_pass(detection, positions, references.get(number), defaults)))
            except WireError as error:
                raise WireError(
                    error.reason, f"{detection.feature_class}, event id {number}: {error.message}"
                ) from error
    passes.sort(key=lambda pair: pair[0])
    report = replace(report, passes=tuple(one for _, one in passes))
    check_message(report, limits)
    return report


def _read_pass(
    detection: Detection, positions: PositionReader, reference: MapReference | None, defaults: ThirdPartyDefaults
) -> PassReport:
    instant = read_timestamp(detection.envelope.timestamp)
    if instant is None:
        raise WireError("bad-time", "an event needs a timestamp")
    status = read_status(detection, reference)
    evidence = read_evidence(detection, status, instant, defaults)
    stated = None if detection.place is None else positions.read(detection.place, instant)
    own_sign = carries_sign(detection.feature_class)
    valid = detection.valid and not evidence.invalid
    return PassReport(
        *_times(evidence, instant),
        status=status,
        weight_for=evidence.weight_for,
        # a sign that is crossed out or covered as a whole still stands: that is no evidence against it
        weight_against=evidence.weight_against if valid else 0.0,
        feature_class=detection.feature_class,
        sign=detection.sign if own_sign else evidence.sign,
        value=detection.value if own_sign else evidence.value,
        reference=reference,
        position=_place(evidence, stated),
        frames_detected=evidence.frames[0],
        frames_missed=evidence.frames[1],
        frames_blocked=evidence.frames[2],
        valid=valid,
    )


def _times(evidence: Evidence, instant: datetime) -> tuple[datetime, datetime]:
    if not evidence.started_at - _TIME_TOLERANCE <= instant <= evidence.ended_at + _TIME_TOLERANCE:
        raise WireError(
            "contradiction",
            f"the event's timestamp {instant.isoformat()} is not within the pass "
            f"{evidence.started_at.isoformat()} to {evidence.ended_at.isoformat()}",
        )
    return evidence.started_at, evidence.ended_at


def _place(evidence: Evidence, stated: MeasuredPosition | None) -> MeasuredPosition | None:
    """Return the exact place if the extension has one, which must be the stated one."""
    if evidence.place is None:
        return stated
    exact = evidence.place
    if (
        stated is None
        or not abs(exact.lon - stated.lon) <= _PLACE_TOLERANCE_DEG
        or not abs(exact.lat - stated.lat) <= _PLACE_TOLERANCE_DEG
    ):
        raise WireError("contradiction", "the extension's place is not the place of the event")
    return exact
