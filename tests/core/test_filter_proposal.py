"""The proposal of FastSLAM 2.0 at work: where odometry is coarse, poses are sampled with the measurement."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, InitialPose, Odometry, Sensor, SensorKind
from slamcu_core.filter import FilterParameters, SlamcuFilter, proposal
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature

FRAME = LocalFrame(2.1, 48.9)
LANDMARKS = np.array([[4.0, 2.0], [7.0, -2.0], [10.0, 2.5], [13.0, -2.0], [16.0, 2.0], [19.0, -2.5]])


@pytest.mark.parametrize("kind", list(SensorKind))
def test_a_robot_with_coarse_odometry_stays_on_its_way_by_conditioning(
    kind: SensorKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    conditioned = 0
    condition = proposal.condition

    def counted(*arguments: object, **options: object) -> object:
        nonlocal conditioned
        conditioned += 1
        return condition(*arguments, **options)  # type: ignore[arg-type]  # passed on as they came

    monkeypatch.setattr(proposal, "condition", counted)
    sensor = Sensor("eye", kind=kind, fov_deg=120, max_range_m=8, range_std_m=0.05, position_std_m=0.05)
    header = DriveHeader("r", "s", datetime(2026, 5, 1, tzinfo=UTC), InitialPose(2.1, 48.9, 90.0, 0.05, 1.0), (sensor,))
    places = zip(*FRAME.to_geographic(LANDMARKS), strict=True)
    features = [MapFeature(n, float(lon), float(lat), position_std_m=0.02) for n, (lon, lat) in enumerate(places, 1)]
    robot = SlamcuFilter(HDMap(features), header, FilterParameters.robot(particles=60), rng=np.random.default_rng(0))
    rng, heading = np.random.default_rng(1), 0.0
    pose = np.zeros(2)
    for step in range(1, 61):
        heading += 0.02 * rng.standard_normal()  # which odometry does not see
        pose += 0.25 * np.array([np.cos(heading), np.sin(heading)])
        robot.feed(Odometry(0.25 * step, 1.0, yaw_rate=0.0))
        ahead = (LANDMARKS - pose) @ np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        items = []
        ahead = ahead[(ahead[:, 0] > 0.5) & (np.hypot(*ahead.T) < 8.0)]
        for x, y in ahead + rng.normal(0.0, 0.03, ahead.shape):
            polar = {"range": float(np.hypot(x, y)), "bearing": float(np.arctan2(y, x))}
            plane = {"x": float(x), "y": float(y)}
            items.append(Detection("traffic_sign", **(polar if kind is SensorKind.RANGE_BEARING else plane)))
        robot.feed(DetectionFrame(0.25 * step, "eye", tuple(items)))
    assert conditioned > 20
    assert np.hypot(*(FRAME.to_local(robot.pose.lon, robot.pose.lat) - pose)) < 0.3
