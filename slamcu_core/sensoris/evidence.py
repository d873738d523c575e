"""What one detection event weighs: exactly, by our extension, or by the confidences that SENSORIS has."""

from __future__ import annotations

from datetime import datetime
from typing import NamedTuple

from slamcu_core.errors import WireError
from slamcu_core.evidence import support
from slamcu_core.reports import DetectionStatus, MapReference, MeasuredPosition
from slamcu_core.sensoris.checks import DETECTED
from slamcu_core.sensoris.events import Detection
from slamcu_core.sensoris.extension import find
from slamcu_core.sensoris.policy import ThirdPartyDefaults
from slamcu_core.sensoris.proto import base_pb2, extension_pb2
from slamcu_core.sensoris.times import from_microseconds

_STATUSES = {n: DetectionStatus(name) for name, n in base_pb2.EventDetectionStatus.Type.items() if n}


class Evidence(NamedTuple):
    """The evidence of a pass, and what else the extension says of it."""

    weight_for: float
    weight_against: float
    started_at: datetime
    ended_at: datetime
    frames: tuple[int, int, int] = (0, 0, 0)  # detected, missed, blocked
    place: MeasuredPosition | None = None
    invalid: bool = False
    sign: str | None = None
    value: str | None = None


def read_status(detection: Detection, reference: MapReference | None) -> DetectionStatus:
    """Return the status of an event; one without is a plain detection if it says that something is there.

    Raises WireError with reason ``missing-status``.
    """
    kind = detection.event.detection_status.type
    if not kind and (detection.event.HasField("existence_confidence") or detection.place is not None):
        expected = reference is not None
        return DetectionStatus.EXPECTED_AND_DETECTED if expected else DetectionStatus.NOT_EXPECTED_AND_DETECTED
    if kind not in _STATUSES:
        raise WireError("missing-status", f"detection_status is {kind}, expected one of 1 to 5")
    return _STATUSES[kind]


def read_evidence(
    detection: Detection, status: DetectionStatus, instant: datetime, defaults: ThirdPartyDefaults
) -> Evidence:
    """Return the evidence of an event at an instant.

    Raises WireError where a confidence is not in (0, 100] per cent, or the extension is malformed.
    """
    lam = _stated_confidence(detection, status, defaults)
    exact = find(detection.envelope.extension, extension_pb2.PassEvidence)
    if exact is None:
        weight = 0.0 if lam is None else float(support(lam))
        detected = status in DETECTED
        return Evidence(weight if detected else 0.0, 0.0 if detected else weight, instant, instant)
    place = exact.place
    return Evidence(
        exact.weight_for,
        exact.weight_against,
        from_microseconds(exact.started_at),
        from_microseconds(exact.ended_at),
        (exact.frames_detected, exact.frames_missed, exact.frames_blocked),
        MeasuredPosition(place.longitude, place.latitude, (place.variance_east, place.covariance, place.variance_north))
        if exact.HasField("place")
        else None,
        exact.invalid,
        exact.sign or None,
        exact.value or None,
    )


def _stated_confidence(detection: Detection, status: DetectionStatus, defaults: ThirdPartyDefaults) -> float | None:
    """Return the λ of eq. 1 or eq. 2 that the fields state, or the default; None where the view was blocked."""
    event = detection.event
    if status in DETECTED:
        stated = event.existence_confidence if event.HasField("existence_confidence") else None
        return _confidence("existence_confidence", stated, defaults.detected)
    if status is DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED:
        return None
    stated = event.detection_status.confidence if event.detection_status.HasField("confidence") else None
    lam = _confidence("detection_status.confidence", stated, defaults.not_detected)
    return lam * defaults.unexplained_discount if status is DetectionStatus.EXPECTED_AND_NOT_DETECTED else lam


def _confidence(name: str, confidence: base_pb2.Confidence | None, default: float) -> float:
    if confidence is None:
        return default
    if not 0 < confidence.value <= 100:
        raise WireError("bad-confidence", f"{name} is {confidence.value}, expected 1 to 100 per cent")
    return confidence.value / 100.0
