"""What the server is fed in the bench: a straight road with signs, and cars that report their passes of it."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import numpy as np

from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_core.reports import DetectionStatus, MapReference, MeasuredPosition, PassReport, ReportMessage

MAP = MapIdentity("bench", "1")
SIGNS = 2_000
PASSES = 20  # per message: 18 signs seen, one missed, one found that the map does not have
_SPACING_DEG = 0.0005  # 56 m north-south
_START = datetime(2024, 1, 1, tzinfo=UTC)
_SIDEWAYS_DEG = 0.0001  # 11 m: the finds stand across the road from the mapped signs
_NOISE_DEG = 0.000005  # 0.6 m
_COVARIANCE = (0.3, 0.0, 0.3)  # m²


def road() -> Iterator[MapFeature]:
    """Yield the signs of the map."""
    for number in range(SIGNS):
        yield MapFeature(number + 1, 2.1, 48.0 + _SPACING_DEG * number, sign="SPEED_LIMIT", value="80")


def reports(vehicle: int, drive: int, messages: int, rng: np.random.Generator) -> Iterator[ReportMessage]:
    """Yield the messages of one drive of a vehicle: each about the next stretch of the road, an hour after the last."""
    for number in range(messages):
        first = (vehicle * 7 + drive * 3 + number) * PASSES % (SIGNS - PASSES)
        begun = _START + timedelta(hours=drive * messages + number, seconds=vehicle)
        yield ReportMessage(
            session_id=f"drive-{drive}",
            message_id=number + 1,
            passes=tuple(_pass(first + index, index, begun, rng) for index in range(PASSES)),
            map_identity=MAP,
            sensor_model="bench",
            software_version="bench",
        )


def _pass(sign: int, index: int, begun: datetime, rng: np.random.Generator) -> PassReport:
    begun += timedelta(seconds=2 * index)
    missed, found = index == PASSES - 2, index == PASSES - 1
    status = DetectionStatus.EXPECTED_AND_DETECTED
    if missed:
        status = DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE
    elif found:
        status = DetectionStatus.NOT_EXPECTED_AND_DETECTED
    east, north = _NOISE_DEG * rng.standard_normal(2)
    place = MeasuredPosition(
        2.1 + found * _SIDEWAYS_DEG + float(east), 48.0 + _SPACING_DEG * sign + float(north), _COVARIANCE
    )
    return PassReport(
        started_at=begun,
        ended_at=begun + timedelta(seconds=2),
        status=status,
        weight_for=0.0 if missed else 3.0,
        weight_against=2.0 if missed else 0.1,
        sign="SPEED_LIMIT",
        value="80",
        reference=None if found else MapReference(0, sign + 1),
        position=None if missed else place,
        frames_detected=0 if missed else 24,
        frames_missed=30 if missed else 6,
    )
