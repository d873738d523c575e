"""A simulated drive is physical, reproducible, and its log keeps the truth to itself."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, replace
from itertools import pairwise

import numpy as np
import pytest

from slamcu_core.drive import DetectionFrame, GnssFix, ObjectFrame, Odometry
from slamcu_core.errors import SlamcuError
from slamcu_core.geometry import LocalFrame, compass_to_math
from slamcu_core.models import advance
from slamcu_eval.highway import Drive, HighwayParameters, World, make_drive, make_world, simulate

Drives = list[tuple[World, Drive]]
SHORT = {"length_m": 2_500.0, "normal": 8, "deleted": 3, "new": 5}
SILENT = {
    "speed_scale_std": 0.0,
    "speed_noise_std": 0.0,
    "gyro_bias_std": 0.0,
    "gyro_bias_walk": 0.0,
    "gyro_scale_std": 0.0,
    "gyro_noise_std": 0.0,
}


def test_equal_seeds_give_equal_drives_whatever_the_size_of_the_fleet() -> None:
    world, two = simulate(11, 2, **SHORT)
    again, three = simulate(11, 3, **SHORT)
    assert world.signs == again.signs
    assert [d.header for d in two] == [d.header for d in three[:2]]
    assert [d.records for d in two] == [d.records for d in three[:2]]
    _, other = simulate(12, 1, **SHORT)
    assert other[0].records != two[0].records
    assert two[0].records != two[1].records


def test_records_come_in_order_of_time_and_objects_before_what_they_may_hide(motorway_drives: Drives) -> None:
    _, drive = motorway_drives[0]
    assert all(a.t <= b.t for a, b in pairwise(drive.records))
    frames = [r for r in drive.records if isinstance(r, ObjectFrame | DetectionFrame)]
    assert all(
        isinstance(objects, ObjectFrame) and isinstance(signs, DetectionFrame) and objects.t == signs.t
        for objects, signs in zip(frames[::2], frames[1::2], strict=True)
    )


def test_rates_speeds_and_the_camera_are_those_of_the_contract(motorway_drives: Drives) -> None:
    for _, drive in motorway_drives:
        last = drive.reference.t[-1]
        count = Counter(type(record) for record in drive.records)
        assert count[Odometry] / last == pytest.approx(50.0, rel=0.01)
        assert count[GnssFix] / last == pytest.approx(1.0, rel=0.01)
        assert count[DetectionFrame] / last == pytest.approx(15.0, rel=0.01)
        (camera,) = drive.header.sensors
        assert (camera.rate_hz, camera.fov_deg, camera.max_range_m) == (15.0, 40.0, 80.0)
        frame = LocalFrame(drive.reference.lon[0], drive.reference.lat[0])
        path = frame.to_local(drive.reference.lon, drive.reference.lat)
        speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / np.diff(drive.reference.t)
        assert speed.min() >= 25.0 - 0.1
        assert speed.max() <= 36.0 + 0.1


def test_odometry_without_errors_leads_along_the_reference() -> None:
    _, (drive,) = simulate(4, 1, **SILENT)
    heading = compass_to_math(float(drive.reference.heading_deg[0]))
    frame = LocalFrame(float(drive.reference.lon[0]), float(drive.reference.lat[0]))
    pose = np.array([0.0, 0.0, heading])
    odometry = [record for record in drive.records if isinstance(record, Odometry)]
    dt = float(drive.reference.t[1])
    for record in odometry:
        assert record.yaw_rate is not None
        pose = advance(pose, record.speed * dt, record.yaw_rate * dt)
    end = frame.to_local(drive.reference.lon[-1], drive.reference.lat[-1])
    # 20 km on a plane tangent at the start: it shortens distances by centimetres, and rounding turns a little
    assert np.linalg.norm(pose[:2] - end) < 3.0


def test_real_odometry_drifts(motorway_drives: Drives) -> None:
    scales = [drive.motion_errors.speed_scale for _, drive in motorway_drives]
    biases = [drive.motion_errors.gyro_bias for _, drive in motorway_drives]
    assert 0.004 < np.std(scales) < 0.012
    assert 2e-4 < np.std(biases) < 1e-3


def test_reference_headings_are_compass_headings_where_they_are(motorway_drives: Drives) -> None:
    for _, drive in motorway_drives[:3]:
        r = drive.reference
        for at in (10, r.t.size // 2, r.t.size - 11):
            here = LocalFrame(float(r.lon[at]), float(r.lat[at]))
            ahead, behind = (here.to_local(r.lon[i], r.lat[i]) for i in (at + 3, at - 3))
            east, north = ahead - behind
            bearing = np.rad2deg(np.arctan2(east, north)) % 360.0
            assert abs((bearing - r.heading_deg[at] + 180.0) % 360.0 - 180.0) < 0.02


def test_satellite_errors_wander_slowly(motorway_drives: Drives) -> None:
    errors = []
    for world, drive in motorway_drives:
        fixes = [record for record in drive.records if isinstance(record, GnssFix)]
        said = world.frame.to_local([f.lon for f in fixes], [f.lat for f in fixes])
        path = world.frame.to_local(drive.reference.lon, drive.reference.lat)
        times = [f.t for f in fixes]
        true = np.stack([np.interp(times, drive.reference.t, path[:, axis]) for axis in (0, 1)], axis=-1)
        errors.append(said - true)
    assert 1.0 < np.sqrt(np.mean([np.mean(e**2) for e in errors])) < 2.2
    a, b = np.concatenate([e[:-30] for e in errors]).ravel(), np.concatenate([e[30:] for e in errors]).ravel()
    assert np.corrcoef(a, b)[0, 1] > 0.5  # after half a minute


def test_the_start_is_as_good_as_a_fix(motorway_drives: Drives) -> None:
    errors = []
    for world, drive in motorway_drives:
        start, r = drive.header.initial_pose, drive.reference
        there = world.frame.to_local([start.lon, r.lon[0]], [start.lat, r.lat[0]])
        errors.append(float(np.linalg.norm(there[0] - there[1])))
        assert start.position_std_m >= 1.5
    assert 0.8 < np.mean(errors) < 4.0


def test_the_log_holds_nothing_of_the_truth(motorway_drives: Drives) -> None:
    world, _ = motorway_drives[0]
    drives = [make_drive(world, 0, vehicle) for vehicle in (0, 1)]
    assert drives[0].header.sensors == drives[1].header.sensors  # a data sheet, not a calibration
    for drive in drives:
        text = json.dumps([asdict(drive.header), *(asdict(record) for record in drive.records)], default=str)
        for secret in (*asdict(drive.camera_errors).values(), *asdict(drive.motion_errors).values()):
            assert str(secret)[:11] not in text
        for word in ("truth", "source", "hidden", "deleted", "ghost", "bias", "object_id"):
            assert word not in text


def test_confidence_and_order_do_not_tell_signs_from_false_alarms(motorway_drives: Drives) -> None:
    confidence: dict[bool, list[float]] = {True: [], False: []}
    first: list[bool] = []
    for _, drive in motorway_drives:
        sources = iter(drive.sightings.source.tolist())
        for record in drive.records:
            if isinstance(record, DetectionFrame):
                real = [next(sources) >= 0 for _ in record.items]
                for item, truth in zip(record.items, real, strict=True):
                    confidence[truth].append(item.confidence)
                if len(set(real)) == 2 and len(real) == 2:
                    first.append(real[0])
    assert np.mean(confidence[True]) == pytest.approx(np.mean(confidence[False]), abs=0.005)
    assert len(first) > 100
    assert np.mean(first) == pytest.approx(0.5, abs=0.12)


def test_some_trucks_are_reported_and_some_are_not(motorway_drives: Drives) -> None:
    told = blind = 0
    for _, drive in motorway_drives:
        frames = [record for record in drive.records if isinstance(record, ObjectFrame)]
        for frame in np.unique(drive.looks.frame[drive.looks.hidden]).tolist():
            told += bool(frames[frame].items)
            blind += not frames[frame].items
    assert told > 5 * blind > 0


def test_unknown_parameters_are_named() -> None:
    with pytest.raises(SlamcuError, match="range_noise: unknown simulation parameter"):
        simulate(0, 1, range_noise=0.0)
    with pytest.raises(SlamcuError, match="range_std_m: ambiguous"):
        HighwayParameters().having(range_std_m=1.0)
    assert HighwayParameters().having(camera_range_std_m=1.0).camera.range_std_m == 1.0


def test_parameters_are_independent_of_one_another() -> None:
    base = HighwayParameters()
    changed = base.having(deleted=3)
    assert changed.world == replace(base.world, deleted=3)
    assert (changed.vehicle, changed.camera, changed.traffic) == (base.vehicle, base.camera, base.traffic)


def test_a_road_too_short_for_its_signs_is_refused() -> None:
    with pytest.raises(SlamcuError, match="too short for 103 signs"):
        make_world(0, HighwayParameters().having(length_m=1_000.0).world)
