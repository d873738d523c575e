"""A car in a dense field of signs: the scene that the time of a step is quoted for.

A car drives straight east at 20 m/s along the middle of a field in which signs stand in rows on both sides, four for
every five metres of road; three in ten are not in the map. Its camera takes 15 frames/s, sees 80 m and 40°, and shows
each sign in view with a probability of 0.23, so that a frame has about 10 detections (a binomial number, not a fixed
one) of 30 map features and 13 unmapped ones in view. A find stays live until it is far behind: about 50 are.
Odometry comes with every frame, a satellite fix once a second. Everything enters by `SlamcuFilter.feed`; the filter is
timed after it has driven far enough for the number of live finds to have settled, on frames as they come.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

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
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature

Array = NDArray[np.float64]

SPEED = 20.0  # m/s
RATE_HZ = 15.0
SETTLE_S = 20.0  # until as many finds are left behind as are made
_MAP_SPACING_M = 1.75  # along the road
_NEW_SPACING_M = 4.0
_LANES_M = (5.0, 8.0, 11.0, 14.0)  # signs stand this far to the left and right of the road's middle
_WANDER_M = 0.8  # of a sign about its place in the pattern, each axis
_START = LocalFrame(2.1, 48.9)

CAMERA = Sensor(
    "camera",
    fov_deg=40.0,
    min_range_m=2.0,
    max_range_m=80.0,
    rate_hz=RATE_HZ,
    range_std_m=0.3,
    range_std_rel=0.01,
    bearing_std_rad=0.005,
    detection_probability=0.23,
    false_alarms_per_frame=0.01,
)
HEADER = DriveHeader(
    "bench",
    "scene",
    datetime(2026, 5, 1, tzinfo=UTC),
    InitialPose(_START.lon, _START.lat, 90.0, 0.5, 0.3),
    (CAMERA,),
)


@dataclass(frozen=True, slots=True)
class Scene:
    """A field of signs: those of the map, and those that only the car sees; (N, 2) m from the start."""

    mapped: Array
    unmapped: Array

    @classmethod
    def make(cls, seconds: float, rng: np.random.Generator) -> Scene:
        """Plant a field that is long enough for a drive of `seconds`."""
        length = SPEED * seconds + 2.0 * CAMERA.max_range_m
        return cls(_rows(length, _MAP_SPACING_M, 0, rng), _rows(length, _NEW_SPACING_M, 1, rng))

    def hd_map(self) -> HDMap:
        """Return the map that the car has."""
        lon, lat = _START.to_geographic(self.mapped)
        return HDMap(MapFeature(n + 1, float(x), float(y)) for n, (x, y) in enumerate(zip(lon, lat, strict=True)))

    def records(self, seconds: float, rng: np.random.Generator) -> Iterator[Record]:
        """Yield the records of a drive through the field."""
        signs = np.concatenate([self.mapped, self.unmapped])
        for step in range(1, int(seconds * RATE_HZ)):
            t = step / RATE_HZ
            if step % int(RATE_HZ) == 0:
                lon, lat = _START.to_geographic(np.array([SPEED * t, 0.0]) + rng.normal(0.0, 1.0, 2))
                yield GnssFix(t, float(lon), float(lat), 1.5)
            yield Odometry(t, SPEED * (1.0 + 0.002 * rng.normal()), yaw_rate=0.001 * rng.normal())
            yield DetectionFrame(t, CAMERA.id, _detections(signs - [SPEED * t, 0.0], rng))


def in_view(ahead: Array) -> NDArray[np.bool_]:
    """Return which points (N, 2) in the vehicle's frame the camera has in its field of view."""
    distance, bearing = np.hypot(*ahead.T), np.arctan2(ahead[:, 1], ahead[:, 0])
    inside = np.abs(bearing) < np.deg2rad(CAMERA.fov_deg) / 2.0
    return np.asarray(inside & (distance > CAMERA.min_range_m) & (distance < CAMERA.max_range_m))


def _rows(length: float, spacing: float, phase: int, rng: np.random.Generator) -> Array:
    x = np.arange(0.5 * spacing, length, spacing)
    turn = np.arange(len(x)) + phase
    side = np.where(turn % 2, 1.0, -1.0)
    y = side * np.take(_LANES_M, turn // 2 % len(_LANES_M)) + 1.5 * phase
    return np.stack([x, y], axis=1) + rng.uniform(-_WANDER_M, _WANDER_M, (len(x), 2))


def _detections(ahead: Array, rng: np.random.Generator) -> tuple[Detection, ...]:
    seen = ahead[in_view(ahead) & (rng.random(len(ahead)) < CAMERA.detection_probability)]
    distance = np.hypot(*seen.T)
    distance += rng.standard_normal(len(seen)) * (CAMERA.range_std_m + CAMERA.range_std_rel * distance)
    bearing = np.arctan2(seen[:, 1], seen[:, 0]) + CAMERA.bearing_std_rad * rng.standard_normal(len(seen))
    return tuple(
        Detection("traffic_sign", range=float(r), bearing=float(b)) for r, b in zip(distance, bearing, strict=True)
    )
