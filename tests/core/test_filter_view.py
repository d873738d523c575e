"""To give rows up by the mean pose changes nothing: the same drive with and without it, to rounding."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from slamcu_core.drive import (
    Detection,
    DetectionFrame,
    DriveHeader,
    InitialPose,
    Mount,
    ObjectFrame,
    Occluder,
    Odometry,
    Sensor,
    SensorKind,
)
from slamcu_core.filter import FeatureEstimate, FilterParameters, SlamcuFilter, outline, view
from slamcu_core.geometry import LocalFrame, wrap_angle
from slamcu_core.hd_map import HDMap, MapFeature
from slamcu_core.models import shadow_angle

FRAME = LocalFrame(2.1, 48.9)


TRUCKS = Occluder(20.0, 0.3, 3.0), Occluder(45.0, -0.1, 2.5)


def _turned(bearing: float, by_deg: float) -> float:
    return float(wrap_angle(bearing + np.deg2rad(by_deg)))


def _drive(
    kind: SensorKind,
    heading_deg: float,
    fov_deg: float,
    trucks: tuple[Occluder, ...] = TRUCKS,
    *,
    yaw_deg: float = 3.0,
    frames: int = 20,
) -> list[FeatureEstimate]:
    """Drive 40 m past fifty signs, a third of them not in the map, with trucks ahead and a wide start."""
    trucks = tuple(replace(truck, bearing=_turned(truck.bearing, 3.0 - yaw_deg)) for truck in trucks)
    rng = np.random.default_rng(7)
    sensor = Sensor("eye", kind=kind, mount=Mount(1.5, 0.4, yaw_deg), fov_deg=fov_deg, max_range_m=60.0, rate_hz=10.0)
    header = DriveHeader(
        "v", "s", datetime(2026, 5, 1, tzinfo=UTC), InitialPose(2.1, 48.9, heading_deg, 1.0, 2.0), (sensor,)
    )
    angle = np.deg2rad(90.0 - heading_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    signs = np.stack([rng.uniform(-10.0, 120.0, 50), rng.choice([-9.0, -5.0, 5.0, 9.0], 50)], axis=1)
    lon, lat = FRAME.to_geographic(signs[:34] @ turn.T)
    features = [MapFeature(n + 1, float(x), float(y)) for n, (x, y) in enumerate(zip(lon, lat, strict=True))]
    car = SlamcuFilter(HDMap(features), header, FilterParameters(particles=30), rng=np.random.default_rng(1))
    for step in range(1, frames + 1):
        t = 0.2 * step
        car.feed(Odometry(t, 10.0, yaw_rate=0.0))
        car.feed(ObjectFrame(t, "eye", trucks))
        place = signs - [10.0 * t + 1.5, 0.4]
        distance, bearing = np.hypot(*place.T), np.arctan2(place[:, 1], place[:, 0]) - np.deg2rad(3.0)
        seen = (np.abs(bearing) < np.deg2rad(fov_deg) / 2) & (distance < 60.0) & (rng.random(50) < 0.5)
        items = []
        for index in seen.nonzero()[0]:
            r, b = distance[index] + 0.3 * rng.normal(), bearing[index] + 0.005 * rng.normal()
            if kind is SensorKind.RANGE_BEARING:
                items.append(Detection("traffic_sign", range=float(r), bearing=_turned(b, 3.0 - yaw_deg)))
            else:
                x, y = signs[index] - [10.0 * t, 0.0] + 0.1 * rng.normal(size=2)
                items.append(Detection("traffic_sign", x=float(x), y=float(y)))
        car.feed(DetectionFrame(t, "eye", tuple(items)))
    return car.features()


@pytest.mark.parametrize(
    ("kind", "heading_deg", "fov_deg"),
    [
        (SensorKind.RANGE_BEARING, 90.0, 60.0),
        (SensorKind.RANGE_BEARING, 270.0, 60.0),
        (SensorKind.RANGE_BEARING, 200.0, 360.0),
        (SensorKind.POSITION, 270.0, 120.0),
    ],
)
def test_what_is_given_up_by_the_mean_pose_could_not_have_mattered(
    kind: SensorKind, heading_deg: float, fov_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view, "_MANY", 10**9)
    every = _drive(kind, heading_deg, fov_deg)
    monkeypatch.setattr(view, "_MANY", 0)
    some = _drive(kind, heading_deg, fov_deg)
    assert len(every) > 36  # the map's 34, and finds
    assert [(f.state, f.passes) for f in some] == [(f.state, f.passes) for f in every]
    for one, other in zip(some, every, strict=True):
        assert (one.lon, one.lat) == pytest.approx((other.lon, other.lat), abs=1e-11)
        # a detection that comes as a surprise is held against the rows looked at, which are more if none is given up
        assert one.masses.exists == pytest.approx(other.masses.exists, abs=1e-3)


def test_most_rows_of_a_dense_map_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[tuple[int, int]] = []
    sort = outline.MeanLook.close_ones_first

    def counted(self: outline.MeanLook, rows: outline.Outline, *rest: object) -> object:
        result = sort(self, rows, *rest)  # type: ignore[arg-type]  # passed on as they came
        looked.append((result[0].mapped, rows.mapped))
        return result

    monkeypatch.setattr(view, "_MANY", 0)
    monkeypatch.setattr(outline.MeanLook, "close_ones_first", counted)
    _drive(SensorKind.RANGE_BEARING, 90.0, 60.0, trucks=())  # what may be hidden is looked at
    close, within_reach = np.sum(looked[-10:], axis=0)
    assert 0 < close < 0.8 * within_reach


def test_what_a_detection_may_belong_to_does_not_hang_on_where_bearings_turn_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A sensor that sees all around is mounted in many ways, so that things lie at ±π by its own axes."""
    fit = outline.MeanLook._fit
    fitting: list[set[int]] = []

    def noted(self: outline.MeanLook, rows: outline.Outline, *rest: object) -> object:
        result = fit(self, rows, *rest)  # type: ignore[arg-type]  # passed on as they came
        fitting.append(set(rows.rows[: rows.mapped][result].tolist()))
        return result

    monkeypatch.setattr(view, "_MANY", 0)
    monkeypatch.setattr(outline.MeanLook, "_fit", noted)
    told = []
    for yaw_deg in range(3, 360, 10):
        fitting.clear()
        _drive(SensorKind.RANGE_BEARING, 90.0, 360.0, yaw_deg=float(yaw_deg), frames=6)
        told.append([*fitting])
    assert all(0 < len(rows) < 34 for rows in told[0])
    assert all(one == told[0] for one in told[1:])


@pytest.mark.parametrize("truck", TRUCKS)
def test_the_edge_of_a_shadow_is_one_in_every_direction(truck: Occluder) -> None:
    edge = shadow_angle(truck)
    offsets = np.array([-edge - 0.5, -edge, 0.0, edge, edge + 0.5])
    for ahead in np.linspace(-np.pi, np.pi, 73):
        bearing = wrap_angle(ahead + offsets)
        found = outline._at_an_edge((replace(truck, bearing=ahead),), np.full(5, 60.0), bearing, np.full(5, 0.001))
        assert found.tolist() == [False, True, False, True, False], ahead
