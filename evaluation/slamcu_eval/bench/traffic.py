"""What the cloud is fed in the bench: parallel roads with signs, and cars that report stretches of them from all over.

The traffic is spread evenly over the whole map, which is the hard case: a batch finds few features twice. Of the mapped
signs that a car passes, 95 % are seen and 5 % missed; every hundredth is gone, and missed by all. At each stretch of
twenty stands one new sign, which cars find, or report as a watch feature once they have heard of it. Clutter adds a
find that nobody else will make to every third message. So some 94 % of the passes are about map features.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_core.reports import DetectionStatus, MapReference, MeasuredPosition, PassReport, ReportMessage

MAP = MapIdentity("bench", "1")
STRETCH = 20  # mapped signs that one message is about
ROAD = 500  # mapped signs along one road
_LON, _LAT = 2.0, 48.0
_SPACING_DEG = 0.0005  # 56 m north-south between signs
_ROADS_DEG = 0.003  # 223 m east-west between roads
_ACROSS_DEG = 0.0001  # 7 m: new signs stand across the road
_NOISE_DEG = 0.000005  # 0.6 m
_COVARIANCE = (0.3, 0.0, 0.3)  # m²
_START = datetime(2024, 1, 1, tzinfo=UTC)
_MISSED, _CLUTTER, _GONE = 0.05, 1.0 / 3.0, 100
_SEEN_STATUS = DetectionStatus.EXPECTED_AND_DETECTED
_MISSED_STATUS = DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE
_FOUND_STATUS = DetectionStatus.NOT_EXPECTED_AND_DETECTED


def place(number: int) -> tuple[float, float]:
    """Return longitude and latitude of a mapped sign, counted from 0."""
    road, along = divmod(number, ROAD)
    return _LON + _ROADS_DEG * road, _LAT + _SPACING_DEG * along


def stretch_at(lon: float, lat: float) -> int:
    """Return the stretch whose new sign stands at a place."""
    road = round((lon - _ACROSS_DEG - _LON) / _ROADS_DEG)
    return (road * ROAD + round((lat - _LAT) / _SPACING_DEG)) // STRETCH


def road(features: int) -> Iterator[MapFeature]:
    """Yield the signs of the map."""
    for number in range(features):
        yield MapFeature(number + 1, *place(number), sign="SPEED_LIMIT", value="80")


ROAD_SQL = f"""
SELECT n + 1 AS object_id, {_LON} + {_ROADS_DEG} * (n / {ROAD}) AS lon, {_LAT} + {_SPACING_DEG} * (n % {ROAD}) AS lat
FROM generate_series(0, $1::bigint - 1) AS n"""  # noqa: S608  (constants)
"""The same in SQL, for maps too large to be written to a file first."""


@dataclass(frozen=True, slots=True)
class Traffic:
    """Cars on a map of a number of signs."""

    features: int
    watched: Mapping[int, int]  # watch features that the cars know, by stretch

    def messages(
        self, vehicle: int, drive: int, count: int, rng: np.random.Generator, *, every_s: float = 3600.0
    ) -> Iterator[ReportMessage]:
        """Yield the messages of one drive of a vehicle, each about a stretch anywhere on the map."""
        for number in range(count):
            begun = _START + timedelta(seconds=every_s * (drive + number) + vehicle)
            yield ReportMessage(
                session_id=f"drive-{drive}",
                message_id=number + 1,
                passes=tuple(self._passes(int(rng.integers(self.features // STRETCH)), begun, rng)),
                map_identity=MAP,
                sensor_model="bench",
                software_version="bench",
            )

    def _passes(self, stretch: int, begun: datetime, rng: np.random.Generator) -> Iterator[PassReport]:
        first = stretch * STRETCH
        missed = rng.random(STRETCH) < _MISSED
        for index in range(STRETCH):
            gone = (first + index) % _GONE == _GONE - 1
            yield _pass(
                place(first + index),
                begun + timedelta(seconds=2 * index),
                _MISSED_STATUS if gone or missed[index] else _SEEN_STATUS,
                rng,
                reference=MapReference(0, first + index + 1),
            )
        lon, lat = place(first + STRETCH // 2)
        watch = self.watched.get(stretch)
        yield _pass(
            (lon + _ACROSS_DEG, lat),
            begun + timedelta(seconds=21),
            _FOUND_STATUS if watch is None else _SEEN_STATUS,
            rng,
            reference=None if watch is None else MapReference(-1, watch),
        )
        if rng.random() < _CLUTTER:
            shift = float(rng.uniform(0.3, 0.7))  # between two roads
            yield _pass((lon + shift * _ROADS_DEG, lat), begun + timedelta(seconds=25), _FOUND_STATUS, rng)


def _pass(
    where: tuple[float, float],
    begun: datetime,
    status: DetectionStatus,
    rng: np.random.Generator,
    *,
    reference: MapReference | None = None,
) -> PassReport:
    missed = status is _MISSED_STATUS
    east, north = _NOISE_DEG * rng.standard_normal(2)
    position = MeasuredPosition(where[0] + float(east), where[1] + float(north), _COVARIANCE)
    return PassReport(
        started_at=begun,
        ended_at=begun + timedelta(seconds=2),
        status=status,
        weight_for=0.0 if missed else 3.0,
        weight_against=2.0 if missed else 0.1,
        sign="SPEED_LIMIT",
        value="80",
        reference=reference,
        position=None if missed else position,
        frames_detected=0 if missed else 24,
        frames_missed=30 if missed else 6,
    )
