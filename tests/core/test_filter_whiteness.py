"""How much of a sensor's noise is new in each frame is learned from the map, whatever is wrong with pose and map."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
import pytest

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, InitialPose, Odometry, Record, Sensor, SensorKind
from slamcu_core.filter import SlamcuFilter
from slamcu_core.filter.detections import Instant
from slamcu_core.filter.whiteness import Whiteness
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature
from slamcu_core.models import SensorModel, advance

CAMERA = Sensor("camera", SensorKind.RANGE_BEARING, range_std_m=0.3, range_std_rel=0.05, bearing_std_rad=0.006)
LIDAR = Sensor("lidar", SensorKind.POSITION, position_std_m=0.2)
DT, TIME_S = 1.0 / 15.0, 0.3
ASSUMED = DT / TIME_S
SIGNS = np.array([[30.0, 45.0, 62.0], [4.0, -6.0, 8.0]])


def learned(sensor: Sensor, correlation: float, *, frames: int = 400, dt: float = DT, wrong: float = 3.0) -> float:
    """Return what is learned on a bend from frames whose errors are correlated, with pose and map off by `wrong` m."""
    rng, model = np.random.default_rng(5), SensorModel(sensor)
    whiteness = Whiteness(model, TIME_S)
    pose, reckoned = np.zeros(3), np.array([400.0, -70.0, 2.0])
    error = rng.normal(size=SIGNS.shape)
    for index in range(frames):
        pose, reckoned = advance(pose, 0.05, 0.0005), advance(reckoned, 0.05, 0.0005)
        truth = model.predict(pose[:, None], SIGNS)
        noise = model.noise(truth)
        error = correlation * error + np.sqrt(1.0 - correlation**2) * rng.normal(size=SIGNS.shape)
        believed = pose + np.array([wrong / 3.0, -wrong / 3.0, 0.002 * wrong])
        now = Instant(index * dt, ASSUMED, 1.0, believed, reckoned, 0.75)
        whiteness.learn(now, [0, 1, 2], SIGNS + wrong / 4.0, truth + np.sqrt(noise) * error, noise)
    return whiteness.fresh(ASSUMED)


@pytest.mark.parametrize("sensor", [CAMERA, LIDAR], ids=lambda sensor: sensor.id)
@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.5])
def test_what_is_new_in_a_frame_is_learned(sensor: Sensor, correlation: float) -> None:
    assert learned(sensor, correlation) == pytest.approx((1 - correlation) / (1 + correlation), rel=0.2)


def test_it_is_never_less_than_assumed() -> None:
    assert learned(CAMERA, 0.95) == ASSUMED


def test_frames_that_lie_apart_are_not_compared() -> None:
    assert learned(CAMERA, 0.5, dt=0.4) == Whiteness(SensorModel(CAMERA), TIME_S).fresh(ASSUMED)
    assert Whiteness(SensorModel(CAMERA), TIME_S).fresh(ASSUMED) == pytest.approx(ASSUMED)


def test_wrong_associations_make_nothing_worth_more_than_itself() -> None:
    model = SensorModel(CAMERA)
    whiteness = Whiteness(model, TIME_S)
    for index in range(100):
        now = Instant(index * DT, ASSUMED, 1.0, np.zeros(3), np.zeros(3), 0.0)
        shown = model.predict(np.zeros((3, 1)), SIGNS)
        noise = model.noise(shown)
        whiteness.learn(now, [0, 1, 2], SIGNS, shown + (index % 2) * 40.0 * np.sqrt(noise), noise)
    assert whiteness.fresh(ASSUMED) == 1.0


FRAME = LocalFrame(2.1, 48.9)
ROAD = np.array([[x, y] for x in range(30, 400, 60) for y in (-7.0, 7.0)], dtype=float)
FOUND = np.array([340.0, 5.0])


def _drive(rng: np.random.Generator) -> Iterator[Record]:
    """Drive at 20 m/s past signs of the map to one that it lacks, with the camera's own white noise."""
    model = SensorModel(CAMERA)
    for step in range(1_050):
        yield Odometry(step / 60.0, 20.0, yaw_rate=0.0)
        if step % 4:
            continue
        pose, items = np.array([step / 3.0, 0.0, 0.0]), []
        for place in (*ROAD, FOUND):
            measurement = model.predict(pose[:, None], place[:, None])
            if 5.0 < measurement[0, 0] < 78.0 and abs(measurement[1, 0]) < model.half_angle and place[0] > pose[0]:
                distance, bearing = measurement[:, 0] + rng.normal(size=2) * np.sqrt(model.noise(measurement))[:, 0]
                items.append(Detection("traffic_sign", range=float(distance), bearing=float(bearing)))
        yield DetectionFrame(step / 60.0, "camera", tuple(items))


def test_a_find_is_as_well_placed_as_white_noise_allows() -> None:
    features = []
    for index, place in enumerate(ROAD):
        lon, lat = FRAME.to_geographic(place)
        features.append(MapFeature(index + 1, float(lon), float(lat), position_std_m=0.05))
    start = InitialPose(2.1, 48.9, 90.0, position_std_m=0.1, heading_std_deg=0.1)
    header = DriveHeader("car", "drive", datetime(2026, 1, 1, tzinfo=UTC), start, (CAMERA,))
    areas = {}
    for learns in (True, False):
        with pytest.MonkeyPatch.context() as patch:
            if not learns:
                patch.setattr(Whiteness, "fresh", lambda _self, share: share)
            car = SlamcuFilter(HDMap(features), header, rng=np.random.default_rng(2))
            for record in _drive(np.random.default_rng(3)):
                car.feed(record)
        finds = [one for one in car.features() if one.feature is None]
        assert len(finds) == 1
        xx, xy, yy = finds[0].covariance_m2
        areas[learns] = np.sqrt(xx * yy - xy * xy)
    assert areas[True] < 0.75 * areas[False]  # what poses and the calibration are unsure of is left
