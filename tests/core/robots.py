"""A robot that looks around an arena of like things, as tests of the filter drive it."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from slamcu_core.drive import Detection, DriveHeader, InitialPose, Sensor
from slamcu_core.geometry import LocalFrame, wrap_angle
from slamcu_core.hd_map import HDMap, MapFeature

FRAME = LocalFrame(2.1, 48.9)
RATE_HZ = 5.0
Place = tuple[float, float]


def header(*, reach_m: float, detection_probability: float, position_std: float, heading_std_deg: float) -> DriveHeader:
    """Return the start of a drive at the origin of `FRAME`, to the east, with one camera."""
    camera = Sensor(
        "camera",
        fov_deg=100.0,
        min_range_m=0.2,
        max_range_m=reach_m,
        rate_hz=RATE_HZ,
        range_std_m=0.05,
        bearing_std_rad=0.02,
        detection_probability=detection_probability,
    )
    start = InitialPose(2.1, 48.9, 90.0, position_std, heading_std_deg)
    return DriveHeader("robot", "s", datetime(2026, 5, 1, tzinfo=UTC), start, (camera,))


def map_of(things: Sequence[Place]) -> HDMap:
    """Return a map of things, numbered from 0."""
    features = []
    for number, place in enumerate(things):
        lon, lat = (float(part) for part in FRAME.to_geographic(place))
        features.append(MapFeature(number, lon, lat, position_std_m=0.02))
    return HDMap(features)


def looked(
    camera: Sensor, things: Sequence[Place], place: np.ndarray, heading: float, rng: np.random.Generator
) -> tuple[Detection, ...]:
    """Return what a look from a true pose detects of things."""
    away = np.array(things) - place
    distance, bearing = np.hypot(*away.T), wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - heading)
    seen = (distance < camera.max_range_m) & (np.abs(bearing) < np.deg2rad(0.5 * camera.fov_deg))
    seen &= rng.random(len(things)) < camera.detection_probability
    return tuple(
        Detection("traffic_sign", range=float(r + 0.05 * rng.normal()), bearing=float(b + 0.02 * rng.normal()))
        for r, b in zip(distance[seen], bearing[seen], strict=True)
    )
