"""A drive log as the format's documentation shows it."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import settings

# the same examples everywhere, and no test that fails because the machine is busy
settings.register_profile("slamcu", derandomize=True, deadline=None)
settings.load_profile("slamcu")

HEADER: dict[str, Any] = {
    "type": "header",
    "format": "slamcu-drive-log",
    "version": 1,
    "vehicle_id": "veh-007",
    "fleet_id": "demo",
    "session_id": "2026-05-01T08:00Z-007",
    "start_time": "2026-05-01T08:00:00Z",
    "frame": "wgs84",
    "wheelbase_m": 2.9,
    "initial_pose": {"lon": 2.1, "lat": 48.9, "heading_deg": 87.0, "position_std_m": 1.5, "heading_std_deg": 2.0},
    "sensors": [
        {
            "id": "front_camera",
            "kind": "range_bearing",
            "fov_deg": 40,
            "min_range_m": 2,
            "max_range_m": 80,
            "rate_hz": 15,
            "mount": {"x": 1.8, "y": 0.0, "yaw_deg": 0},
            "range_std_m": 0.3,
            "range_std_rel": 0.03,
            "bearing_std_rad": 0.006,
            "detection_probability": 0.9,
            "false_alarms_per_frame": 0.01,
            "classes": ["traffic_sign"],
        },
        {"id": "lidar", "kind": "position", "classes": ["pole"]},
    ],
}
DETECTIONS = {
    "t": 0.07,
    "type": "detections",
    "sensor": "front_camera",
    "items": [
        {
            "range": 35.2,
            "bearing": 0.051,
            "class": "traffic_sign",
            "sign": "SPEED_LIMIT",
            "value": "80",
            "confidence": 0.93,
        }
    ],
}
RECORDS: list[dict[str, Any]] = [
    {"t": 0.02, "type": "odometry", "speed": 27.8, "yaw_rate": 0.0012},
    {"t": 0.04, "type": "odometry", "speed": 27.8, "steering": 0.0011},
    DETECTIONS,
    {
        "t": 0.07,
        "type": "objects",
        "sensor": "front_camera",
        "items": [{"range": 18.0, "bearing": 0.02, "width": 2.5, "class": "truck"}],
    },
    {"t": 0.08, "type": "detections", "sensor": "lidar", "items": [{"x": 3.0, "y": -1.5, "class": "pole"}]},
    {"t": 0.10, "type": "detections", "sensor": "front_camera", "items": []},
    {"t": 1.00, "type": "gnss", "lon": 2.1003, "lat": 48.9001, "std_m": 2.5},
]


@pytest.fixture
def header() -> dict[str, Any]:
    """The header, to be changed at will."""
    return copy.deepcopy(HEADER)


@pytest.fixture
def records() -> list[dict[str, Any]]:
    """A record of each type, to be changed at will."""
    return copy.deepcopy(RECORDS)


@pytest.fixture
def feature_of() -> Callable[..., dict[str, Any]]:
    """Make a GeoJSON feature of a map."""

    def make(feature_id: object = 17, coordinates: object = (2.1, 48.9), **properties: object) -> dict[str, Any]:
        return {
            "type": "Feature",
            "id": feature_id,
            "geometry": {"type": "Point", "coordinates": coordinates},
            "properties": {"class": "traffic_sign", "sign": "SPEED_LIMIT", "value": "80"} | properties,
        }

    return make


@pytest.fixture
def text_of() -> Callable[..., str]:
    """Write a FeatureCollection of features, with other members before or after them."""

    def make(*features: object, before: dict[str, Any] | None = None, after: dict[str, Any] | None = None) -> str:
        members = {"type": "FeatureCollection"} | (before or {}) | {"features": list(features)} | (after or {})
        return json.dumps(members, indent=1)

    return make
