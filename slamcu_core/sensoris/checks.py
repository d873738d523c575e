"""What a report must satisfy, whoever made it: the same checks before sending and after receiving."""

from __future__ import annotations

import math
from datetime import UTC

from slamcu_core.catalogue import FEATURE_CLASSES, SIGN_TYPES, TRAFFIC_SIGN
from slamcu_core.errors import WireError
from slamcu_core.reports import DetectionStatus, MeasuredPosition, PassReport, ReportMessage
from slamcu_core.sensoris.policy import DEFAULT_LIMITS, WireLimits

INT64_MAX = 2**63 - 1

# tuples: a member is found in them by its identity, in a set by the slow hash of an enumeration
DETECTED = (DetectionStatus.EXPECTED_AND_DETECTED, DetectionStatus.NOT_EXPECTED_AND_DETECTED)
NOT_DETECTED = (
    DetectionStatus.EXPECTED_AND_NOT_DETECTED,
    DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE,
)


def check_message(report: ReportMessage, limits: WireLimits = DEFAULT_LIMITS) -> None:
    """Check a whole message.

    Raises WireError with the reason and what was expected; for a pass, which one (counted from 0).
    """
    if not report.session_id or not 1 <= report.message_id <= INT64_MAX:
        raise WireError(
            "missing-ids",
            f"session_id is {report.session_id!r} and message_id {report.message_id}; "
            "expected a text that is not empty and an integer from 1",
        )
    for name, text in (
        ("session_id", report.session_id),
        ("vehicle_id", report.vehicle_id),
        ("vehicle_fleet_id", report.fleet_id),
        ("source of the map", report.map_identity.source),
        ("version of the map", report.map_identity.version),
        ("sensor_model", report.sensor_model),
        ("software_version", report.software_version),
    ):
        check_text(name, text, limits)
    _check_health(report)
    if len(report.passes) > limits.max_events:
        raise WireError("too-many-events", f"{len(report.passes)} passes, expected at most {limits.max_events}")
    for index, one in enumerate(report.passes):
        try:
            check_pass(one, limits)
        except WireError as error:
            raise WireError(error.reason, f"pass {index}: {error.message}") from None


def check_pass(report: PassReport, limits: WireLimits = DEFAULT_LIMITS) -> None:
    """Check one pass: what a receiver would refuse is refused before it is sent. Raises WireError."""
    _check_kind(report, limits)
    _check_times(report, limits)
    _check_evidence(report, limits)
    if report.position is not None:
        check_position(report.position, limits)
    elif report.status is DetectionStatus.NOT_EXPECTED_AND_DETECTED or report.reference is None:
        raise WireError("missing-position", f"a {report.feature_class} that no MAP_REFERENCE places needs a position")
    if report.reference is not None:
        check_reference(report.reference.tile_id, report.reference.object_id)


def check_text(name: str, text: str, limits: WireLimits) -> None:
    """Refuse text that is long or holds control characters: it goes into logs, tables and pages."""
    if len(text) > limits.max_text or not text.isprintable():
        raise WireError("bad-text", f"{name} must be printable and have at most {limits.max_text} characters")


def check_reference(tile_id: int, object_id: int) -> None:
    """Refuse a map reference whose object id no map can hold."""
    if not 1 <= object_id <= INT64_MAX or abs(tile_id) > INT64_MAX:
        raise WireError("bad-reference", f"the object id of a map reference is {object_id}, expected an integer from 1")


def check_position(position: MeasuredPosition, limits: WireLimits) -> None:
    """Refuse a place off the globe, and a covariance that is not positive definite or says nothing."""
    if not (-180.0 <= position.lon <= 180.0 and -90.0 <= position.lat <= 90.0):
        raise WireError(
            "position-out-of-range",
            f"longitude {position.lon:g}, latitude {position.lat:g}; expected [-180, 180] and [-90, 90] degrees",
        )
    xx, xy, yy = position.covariance_m2
    if not (0.0 < xx < math.inf and 0.0 < yy < math.inf and 0.0 < xx * yy - xy * xy < math.inf):
        raise WireError(
            "bad-covariance", f"the covariance [xx, xy, yy] = [{xx:g}, {xy:g}, {yy:g}] m² is not positive definite"
        )
    most = limits.max_position_std_m**2
    if xx + yy <= most:  # the trace bounds the longer axis
        return
    largest = (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)
    if largest > most:
        raise WireError(
            "bad-covariance",
            f"a standard deviation of {math.sqrt(largest):g} m, expected at most {limits.max_position_std_m:g} m",
        )


def _check_kind(report: PassReport, limits: WireLimits) -> None:
    if report.feature_class not in FEATURE_CLASSES:
        raise WireError(
            "unknown-class",
            f"no SENSORIS event stands for the class {report.feature_class!r}: see slamcu_core.catalogue",
        )
    if report.feature_class == TRAFFIC_SIGN and report.sign is not None and report.sign not in SIGN_TYPES:
        raise WireError("unknown-sign", f"{report.sign!r} is no SENSORIS TrafficSign type")
    if report.sign is not None:
        check_text("sign", report.sign, limits)
    if report.value is not None:
        check_text("value", report.value, limits)


def _check_times(report: PassReport, limits: WireLimits) -> None:
    start, end = report.started_at, report.ended_at
    if start.tzinfo is end.tzinfo is UTC and limits.earliest <= start <= end <= limits.latest:
        return
    for name, instant in (("start", start), ("end", end)):
        if instant.tzinfo is None:
            raise WireError("bad-time", f"the {name} of a pass has no time zone")
        if not limits.earliest <= instant <= limits.latest:
            raise WireError(
                "bad-time",
                f"the {name} of a pass is {instant.isoformat()}, expected "
                f"{limits.earliest.isoformat()} to {limits.latest.isoformat()}",
            )
    if report.ended_at < report.started_at:
        raise WireError(
            "bad-time",
            f"a pass ends at {report.ended_at.isoformat()}, before its start {report.started_at.isoformat()}",
        )


def _check_evidence(report: PassReport, limits: WireLimits) -> None:
    f, a = report.weight_for, report.weight_against
    most = limits.max_pass_weight
    if not (0.0 <= f <= most and 0.0 <= a <= most):  # a NaN fails too
        name, weight = ("against", a) if 0.0 <= f <= most else ("for", f)
        raise WireError("bad-weight", f"the evidence {name} weighs {weight:g}, expected 0 to {most:g}")
    counts = report.frames_detected, report.frames_missed, report.frames_blocked
    if not (min(counts) >= 0 and max(counts) <= limits.max_frames):
        for name, count in zip(("detected", "missed", "blocked"), counts, strict=True):
            if not 0 <= count <= limits.max_frames:
                raise WireError("bad-count", f"{count} frames {name}, expected 0 to {limits.max_frames}")
    if report.status in DETECTED:
        contradicts = f == 0.0 < a
    elif report.status in NOT_DETECTED:
        contradicts = a == 0.0 < f
    else:
        contradicts = f > 0.0 or a > 0.0
    if contradicts:
        raise WireError("contradiction", f"status {report.status} with evidence of {f:g} for and {a:g} against")


def _check_health(report: ReportMessage) -> None:
    health = report.health
    if not 0.0 < health.effective_particles <= 1.0:
        raise WireError("bad-health", f"effective_particles is {health.effective_particles:g}, expected (0, 1]")
    if not 0.0 <= health.unexplained_ratio <= 1.0:
        raise WireError("bad-health", f"unexplained_ratio is {health.unexplained_ratio:g}, expected [0, 1]")
    if not 0.0 <= health.innovation_ratio < math.inf:
        raise WireError("bad-health", f"innovation_ratio is {health.innovation_ratio:g}, expected 0 or more")
