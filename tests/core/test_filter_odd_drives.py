"""The filter where the world is odd: at the antimeridian, after silence, with two sensors, in a hail of detections."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, InitialPose, Mount, Odometry, Record, Sensor
from slamcu_core.filter import SlamcuFilter
from slamcu_core.geometry import LocalFrame, cell_of, cells_within
from slamcu_core.hd_map import HDMap, MapFeature

CAMERA = Sensor(
    "camera", fov_deg=40, min_range_m=2, max_range_m=80, rate_hz=10, range_std_m=0.3, range_std_rel=0.02,
    bearing_std_rad=0.005, detection_probability=0.9,
)  # fmt: skip
SPEED = 20.0
SIGNS = np.array([(100.0, 6.0), (140.0, -6.0), (180.0, 7.0), (220.0, -7.0)])
MAPPED, GONE = [0, 1, 2], (260.0, 6.0)  # sign 3 is not in the map; what the map has at GONE is not there


def car(lon: float, *sensors: Sensor) -> SlamcuFilter:
    frame = LocalFrame(lon, 48.9)
    places = [*SIGNS[MAPPED], GONE]
    features = []
    for number, place in enumerate(places, 1):
        there, lat = (float(value) for value in frame.to_geographic(place))
        features.append(MapFeature(number, (there + 180.0) % 360.0 - 180.0, lat, sign="YIELD"))
    begun = datetime(2026, 5, 1, tzinfo=UTC)
    header = DriveHeader("veh", "session", begun, InitialPose(lon, 48.9, 90.0, 0.3, 0.3), sensors or (CAMERA,))
    return SlamcuFilter(HDMap(features), header, rng=np.random.default_rng(0))


def frame_at(t: float, x: float, rng: np.random.Generator, sensor: str = "camera") -> DetectionFrame:
    items = []
    for place in SIGNS:
        distance, bearing = np.hypot(place[0] - x, place[1]), np.arctan2(place[1], place[0] - x)
        if 2 < distance < 80 and abs(bearing) < np.deg2rad(20) and rng.random() < 0.9:
            noisy = distance + rng.normal() * (0.3 + 0.02 * distance)
            items.append(Detection("traffic_sign", range=noisy, bearing=bearing + 0.005 * rng.normal(), sign="YIELD"))
    return DetectionFrame(t, sensor, tuple(items))


def drive(seconds: float = 15.0) -> Iterator[Record]:
    rng = np.random.default_rng(1)
    for step in range(1, round(seconds * 10)):
        yield Odometry((step - 1) / 10, SPEED, yaw_rate=0.0)
        yield frame_at(step / 10, SPEED * step / 10, rng)


def test_across_the_antimeridian_all_is_as_elsewhere() -> None:
    told = {}
    for lon in (2.1, 179.998):  # 145 m before it
        one = car(lon)
        passes = [report for record in drive() for report in one.feed(record)]
        states = sorted((f.feature.object_id if f.feature else 0, f.state) for f in one.features())
        told[lon] = states, len(passes + one.finish())
        assert -180.0 <= one.pose.lon < 180.0
        assert all(-180.0 <= feature.lon < 180.0 for feature in one.features())
    assert told[2.1] == told[179.998]
    assert told[2.1][0] == [(0, "new"), (1, "normal"), (2, "normal"), (3, "normal"), (4, "deleted")]


@given(st.floats(-180.0, 180.0), st.floats(-85.0, 85.0), st.floats(0.0, 300.0), st.floats(-np.pi, np.pi))
def test_what_is_within_a_radius_is_in_one_of_its_cells(lon: float, lat: float, away: float, course: float) -> None:
    there = LocalFrame(lon, lat).to_geographic([away * np.cos(course), away * np.sin(course)])
    cells = list(cells_within(lon, lat, 300.0, 0.002))
    assert cell_of(float(there[0]), float(there[1]), 0.002) in cells
    assert len(set(cells)) == len(cells)


def test_after_a_silence_of_the_camera_in_view_a_pass_is_another_one() -> None:
    one, rng = car(2.1), np.random.default_rng(1)
    reports = []
    for t in range(3_603):
        one.feed(Odometry(float(t), 0.0, yaw_rate=0.0))
        if t < 3 or t >= 3_600:
            reports += [report for step in range(10) for report in one.feed(frame_at(t + step / 10, 65.0, rng))]
        assert t >= 3 or reports == []
    reports += one.finish()
    seen = [report for report in reports if report.frames_detected > 0]
    assert len(seen) == 4
    assert max((report.ended_at - report.started_at).total_seconds() for report in seen) < 4.0


def test_what_is_learned_of_sensors_ages_as_time_goes_not_as_frames_come() -> None:
    two = car(2.1, CAMERA, replace(CAMERA, id="rear", mount=Mount(0.0, 0.0, 180.0)))
    for step in range(1, 51):
        two.feed(Odometry((step - 1) / 10, SPEED, yaw_rate=0.0))
        two.feed(DetectionFrame(step / 10, "camera"))
        two.feed(DetectionFrame(step / 10, "rear"))
    assert two._calibrations.age == pytest.approx(5.0)


def test_a_hail_of_detections_leaves_the_map_as_it_was() -> None:
    """One frame of 500: most of them can be nothing, and none of them is worth waiting for."""
    one, rng = car(2.1), np.random.default_rng(2)
    for record in drive(15.0):
        if record.t == 5.0 and isinstance(record, DetectionFrame):
            hail = zip(rng.uniform(2, 80, 500), rng.uniform(-0.34, 0.34, 500), strict=True)
            items = tuple(Detection("traffic_sign", range=float(r), bearing=float(b), sign="YIELD") for r, b in hail)
            record = DetectionFrame(5.0, "camera", items)  # noqa: PLW2901
        one.feed(record)
    one.finish()
    states = {f.feature.object_id: f.state for f in one.features() if f.feature}
    assert states == {1: "normal", 2: "normal", 3: "normal", 4: "deleted"}
