"""What was believed gone and is seen again in its place is the mapped thing, not a new one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
import pytest

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, InitialPose, Odometry, Record, Sensor
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature
from slamcu_core.reports import DetectionStatus, PassReport

FRAME = LocalFrame(2.1, 48.9)
HEADER = DriveHeader(
    vehicle_id="car",
    session_id="s",
    start_time=datetime(2026, 5, 1, tzinfo=UTC),
    initial_pose=InitialPose(2.1, 48.9, heading_deg=90.0, position_std_m=0.1, heading_std_deg=2.0),
    sensors=(
        Sensor(
            "camera",
            fov_deg=90.0,
            min_range_m=0.5,
            max_range_m=7.0,
            rate_hz=5.0,
            range_std_m=0.08,
            range_std_rel=0.03,
            bearing_std_rad=0.025,
            detection_probability=0.45,
        ),
    ),
)
AHEAD = {1: (3.0, 0.5), 2: (3.5, -1.5), 3: (5.0, 1.0), 4: (2.5, 1.8)}  # a robot stands and looks east
UNCOVERED_S, END_S = 40.0, 60.0


def mapped(sign: str = "STOP_SIGN") -> HDMap:
    features = []
    for number, place in AHEAD.items():
        lon, lat = (float(part) for part in FRAME.to_geographic(place))
        sure = 0.5 if number == 1 else 0.95  # nothing weighs against its misses
        shown = sign if number == 1 else "STOP_SIGN"
        features.append(MapFeature(number, lon, lat, sign=shown, position_std_m=0.02, existence_confidence=sure))
    return HDMap(features)


def records(seed: int, aside: float = 0.0) -> Iterator[Record]:
    """Sign 1 stands behind a bus that nobody told of, and later is seen, `aside` m to the left of its mapped place."""
    rng = np.random.default_rng(seed)
    for step in range(round(END_S * 5)):
        t = step / 5
        yield Odometry(t, 0.0, yaw_rate=0.0)
        items = []
        for number, (x, mapped_y) in AHEAD.items():
            poor = 0.35 if UNCOVERED_S < t < UNCOVERED_S + 1.0 else 0.0  # the first looks are poor ones
            y = mapped_y + (max(aside, poor) if number == 1 else 0.0)
            if (number != 1 or t > UNCOVERED_S) and rng.random() < 0.45:
                distance, bearing = math.hypot(x, y), math.atan2(y, x)
                items.append(
                    Detection(
                        "traffic_sign",
                        range=distance + rng.normal(0.0, 0.08 + 0.03 * distance),
                        bearing=bearing + rng.normal(0.0, 0.025),
                        sign="STOP_SIGN",
                        confidence=0.9,
                    )
                )
        yield DetectionFrame(t, "camera", tuple(items))


def drive(hd_map: HDMap, seed: int, aside: float = 0.0) -> tuple[SlamcuFilter, list[PassReport]]:
    car = SlamcuFilter(hd_map, HEADER, FilterParameters.robot(particles=50), rng=np.random.default_rng(seed))
    reports = [report for record in records(seed, aside) for report in car.feed(record)]
    return car, reports + car.finish()


@pytest.mark.parametrize("seed", range(4))
def test_what_comes_back_in_its_place_is_no_new_sign(seed: int) -> None:
    car, reports = drive(mapped(), seed)
    states = {one.feature.object_id if one.feature else None: one.state for one in car.features()}
    assert states == dict.fromkeys(AHEAD, "normal")
    (seen,) = (one for one in reports if one.reference is not None and one.reference.object_id == 1)
    assert seen.status is DetectionStatus.EXPECTED_AND_DETECTED
    assert seen.position is not None
    off = FRAME.to_local(seen.position.lon, seen.position.lat) - np.array(AHEAD[1])
    assert float(np.hypot(*off)) < 0.3
    assert [one for one in reports if one.reference is None] == []


@pytest.mark.parametrize("seed", range(4))
def test_another_sign_in_the_place_is_another_sign(seed: int) -> None:
    car, reports = drive(mapped("YIELD"), seed)
    assert sum(one.feature is None and one.sign == "STOP_SIGN" for one in car.features()) == 1
    assert [one.sign for one in reports if one.reference is None] == ["STOP_SIGN"]


@pytest.mark.parametrize("seed", range(4))
def test_what_stands_some_metres_aside_is_not_the_mapped_sign(seed: int) -> None:
    car, _ = drive(mapped(), seed, aside=0.8)
    states = {one.feature.object_id if one.feature else None: one.state for one in car.features()}
    assert states[None] == "new"
    assert states[1] in {"deleted", "moved"}
