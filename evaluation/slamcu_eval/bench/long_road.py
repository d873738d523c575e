"""An endless road for the bench: along a parallel of latitude, a sign every 50 m, every third one not in the map.

The car does 30 m/s. Fast-forwarded, its camera takes 2 frames/s instead of 15 (a sign is then seen about four times),
with odometry at the same rate and a satellite fix every 5 s; everything else is as in a drive at full rate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from slamcu_core.drive import (
    Detection,
    DetectionFrame,
    DriveHeader,
    GnssFix,
    InitialPose,
    Odometry,
    Record,
    Sensor,
)
from slamcu_core.hd_map import HDMap, MapFeature

SPEED = 30.0  # m/s
FULL_RATE_HZ = 15.0
FAST_RATE_HZ = 2.0
SPACING_M = 50.0
_SIDE_M = 7.0  # of the signs from the road's middle, left and right in turn
_LAT, _LON = 48.9, 2.1
_EARTH_M = 6_378_137.0
_E2 = 0.0066943799901413165
_ROOT = 1.0 - _E2 * np.sin(np.deg2rad(_LAT)) ** 2
_M_PER_DEG_LON = float(np.deg2rad(1.0) * _EARTH_M / np.sqrt(_ROOT) * np.cos(np.deg2rad(_LAT)))
_M_PER_DEG_LAT = float(np.deg2rad(1.0) * _EARTH_M * (1.0 - _E2) / _ROOT**1.5)
_YAW_RATE = float(SPEED * np.sin(np.deg2rad(_LAT)) * np.sqrt(_ROOT) / _EARTH_M / np.cos(np.deg2rad(_LAT)))

CAMERA = Sensor(
    "camera",
    fov_deg=40.0,
    min_range_m=2.0,
    max_range_m=80.0,
    rate_hz=FULL_RATE_HZ,
    range_std_m=0.3,
    range_std_rel=0.02,
    bearing_std_rad=0.005,
    detection_probability=0.85,
)
HEADER = DriveHeader(
    "bench", "long road", datetime(2026, 5, 1, tzinfo=UTC), InitialPose(_LON, _LAT, 90.0, 0.5, 0.3), (CAMERA,)
)


def mapped_feature(number: int, s: float, side: float) -> MapFeature:
    """Return the map's feature `number` at arc length s (m) and so far to the left (m)."""
    return MapFeature(number, _LON + s / _M_PER_DEG_LON, _LAT + side / _M_PER_DEG_LAT)


def sign(index: int) -> tuple[float, float]:
    """Return arc length and side (m) of a sign of the road."""
    return index * SPACING_M, _SIDE_M if index % 2 else -_SIDE_M


def hd_map(length_m: float, elsewhere: int = 0) -> HDMap:
    """Return the map of the road, with as many more features in the country around as asked for."""
    signs = range(int(length_m / SPACING_M))
    road = [mapped_feature(i + 1, *sign(i)) for i in signs if i % 3]
    rng = np.random.default_rng(0)
    far = zip(rng.uniform(-4.0, 10.0, elsewhere), rng.uniform(49.1, 55.0, elsewhere), strict=True)
    return HDMap([*road, *(MapFeature(len(signs) + 1 + n, lon, lat) for n, (lon, lat) in enumerate(far))])


@dataclass(slots=True)
class LongDrive:
    """A drive along the road that goes on from where it was."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    t: float = 0.0  # s
    _next_fix: float = 0.0

    @property
    def driven(self) -> float:
        """Metres driven."""
        return SPEED * self.t

    def records(self, seconds: float, rate_hz: float) -> Iterator[Record]:
        """Yield the records of the next seconds."""
        for _ in range(round(seconds * rate_hz)):
            self.t += 1.0 / rate_hz
            yield Odometry(self.t, SPEED, yaw_rate=_YAW_RATE)
            if self.t >= self._next_fix:
                self._next_fix = self.t + 5.0
                east, north = self.rng.normal(0.0, 1.0, 2)
                yield GnssFix(self.t, _LON + (self.driven + east) / _M_PER_DEG_LON, _LAT + north / _M_PER_DEG_LAT, 1.5)
            yield DetectionFrame(self.t, CAMERA.id, tuple(self._detections()))

    def _detections(self) -> Iterator[Detection]:
        first = int(self.driven / SPACING_M)
        for index in range(first, first + int(CAMERA.max_range_m / SPACING_M) + 2):
            s, side = sign(index)
            distance, bearing = np.hypot(s - self.driven, side), np.arctan2(side, s - self.driven)
            in_view = CAMERA.min_range_m < distance < CAMERA.max_range_m and abs(bearing) < np.deg2rad(20.0)
            if in_view and self.rng.random() < CAMERA.detection_probability:
                std = CAMERA.range_std_m + CAMERA.range_std_rel * distance
                yield Detection(
                    "traffic_sign",
                    range=float(distance + std * self.rng.standard_normal()),
                    bearing=float(bearing + CAMERA.bearing_std_rad * self.rng.standard_normal()),
                )
