"""The simulated sensor is never better than the evaluation contract allows: measured from what it puts out."""

from __future__ import annotations

import numpy as np
import pytest

from slamcu_core.drive import DetectionFrame
from slamcu_core.geometry import wrap_angle
from slamcu_eval.highway import Drive, HighwayParameters, World, make_drive, make_world, simulate
from slamcu_eval.highway.camera import FALSE_ALARM, GHOST, PAINTED_SIGN
from slamcu_eval.oracle import oracle_errors, single_sighting_errors, single_sightings

Drives = list[tuple[World, Drive]]


def _true_polar(world: World, drive: Drive) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows of true sightings, and their true range and bearing from where the mount claims to look."""
    seen = drive.sightings
    rows = np.flatnonzero(seen.source >= 0)
    delta = np.array([world.signs[i].place for i in seen.source[rows]]) - seen.camera[rows, :2]
    bearing = wrap_angle(np.arctan2(delta[:, 1], delta[:, 0]) - seen.camera[rows, 2])
    return rows, np.hypot(delta[:, 0], delta[:, 1]), bearing


def test_range_noise_is_at_least_30_cm_and_5_percent(motorway_drives: Drives) -> None:
    scaled, ranges = [], []
    for world, drive in motorway_drives:
        rows, true, _ = _true_polar(world, drive)
        # what is left after the vehicle's own scale error, so that bias does not pass for noise
        noise = drive.sightings.range[rows] - true * (1.0 + drive.camera_errors.range_scale)
        scaled.append(noise / (0.3 + 0.05 * true))
        ranges.append(true)
    ratio, true = np.concatenate(scaled), np.concatenate(ranges)
    for low, high in ((15.0, 35.0), (35.0, 50.0), (50.0, 65.0), (65.0, 80.0)):
        inside = (true >= low) & (true < high)
        assert inside.sum() > 500
        assert ratio[inside].std() >= 0.97


def test_range_error_is_correlated_within_a_pass(motorway_drives: Drives) -> None:
    means, counts = [], []
    for world, drive in motorway_drives:
        rows, true, _ = _true_polar(world, drive)
        source = drive.sightings.source[rows]
        noise = drive.sightings.range[rows] - true * (1.0 + drive.camera_errors.range_scale)
        scaled = noise / (0.3 + 0.05 * true)
        for sign in np.unique(source):
            here = scaled[source == sign]
            if here.size >= 15:
                means.append(here.mean())
                counts.append(here.size)
    independent = np.sqrt(np.mean(1.0 / np.array(counts)))
    assert np.std(means) > 1.2 * independent


def test_every_vehicle_has_a_range_bias_of_its_own() -> None:
    parameters = HighwayParameters().having(length_m=2_500.0, normal=12, deleted=0, new=8)
    world = make_world(5, parameters.world)
    scales, measured = [], []
    for vehicle in range(150):
        drive = make_drive(world, 5, vehicle, parameters)
        rows, true, _ = _true_polar(world, drive)
        scales.append(drive.camera_errors.range_scale)
        measured.append(np.average(drive.sightings.range[rows] / true - 1.0, weights=1.0 / (0.3 + 0.05 * true) ** 2))
    assert np.std(scales) >= 0.015
    assert np.corrcoef(scales, measured)[0, 1] > 0.9
    assert np.std(measured) >= 0.015


def test_a_bias_common_to_the_fleet_can_be_set() -> None:
    _, drives = simulate(3, 20, length_m=2_000.0, normal=5, deleted=0, new=0, common_range_bias=0.1)
    assert np.mean([drive.camera_errors.range_scale for drive in drives]) == pytest.approx(0.1, abs=0.02)


def test_bearings_are_noisy_and_each_mount_is_a_little_askew(motorway_drives: Drives) -> None:
    residuals, yaws = [], []
    for world, drive in motorway_drives:
        rows, _, bearing = _true_polar(world, drive)
        error = drive.sightings.bearing[rows] - bearing
        residuals.append(error - error.mean())
        yaws.append(-error.mean())
        assert -error.mean() == pytest.approx(drive.camera_errors.mount_yaw, abs=1.5e-3)
    assert np.concatenate(residuals).std() >= 0.006
    assert np.std(yaws) > 1e-3


def test_detection_probability_is_at_most_0_9_and_misses_come_in_bursts(motorway_drives: Drives) -> None:
    hits, after_miss, pairs = [], [], 0
    for _, drive in motorway_drives:
        looks = drive.looks
        hits.append(looks.detected[~looks.hidden])
        follows = (np.diff(looks.sign) == 0) & (np.diff(looks.frame) == 1)
        follows &= ~looks.hidden[1:] & ~looks.hidden[:-1] & (looks.range[1:] < 60.0) & (looks.range[:-1] < 60.0)
        missed = follows & ~looks.detected[:-1]
        after_miss.append(~looks.detected[1:][missed])
        pairs += int(missed.sum())
    miss_rate = 1.0 - np.concatenate(hits).mean()
    assert 0.10 <= miss_rate <= 0.25
    assert pairs > 500
    assert np.concatenate(after_miss).mean() > 2.5 * miss_rate


def test_nothing_is_detected_through_a_truck(motorway_drives: Drives) -> None:
    for _, drive in motorway_drives:
        assert not (drive.looks.hidden & drive.looks.detected).any()


def test_at_least_one_pass_in_a_hundred_is_wholly_hidden(motorway_drives: Drives) -> None:
    hidden = [
        bool(drive.looks.hidden[drive.looks.sign == sign].all())
        for _, drive in motorway_drives
        for sign in np.unique(drive.looks.sign)
    ]
    assert 0.01 <= np.mean(hidden) <= 0.04


def test_false_alarms_ghosts_and_painted_signs_occur(motorway_drives: Drives) -> None:
    frames = sum(isinstance(record, DetectionFrame) for _, drive in motorway_drives for record in drive.records)
    source = np.concatenate([drive.sightings.source for _, drive in motorway_drives])
    assert (source == FALSE_ALARM).sum() / frames >= 0.02
    assert (source == GHOST).sum() / len(motorway_drives) > 30
    assert (source == PAINTED_SIGN).sum() / len(motorway_drives) > 30


def test_painted_signs_travel_at_the_speed_of_lorries(motorway_drives: Drives) -> None:
    seen = []
    for _, drive in motorway_drives:
        rows = drive.sightings.source == PAINTED_SIGN
        place = single_sightings(
            *(v[rows] for v in (drive.sightings.camera, drive.sightings.range, drive.sightings.bearing))
        )
        t = drive.sightings.t[rows]
        for first in np.flatnonzero(np.diff(t, prepend=-100.0) > 20.0):
            stay = np.flatnonzero((t >= t[first]) & (t < t[first] + 20.0))
            lasts = t[stay[-1]] - t[first]
            if lasts > 3.0:
                seen.append(np.linalg.norm(place[stay[-5:]].mean(axis=0) - place[stay[:5]].mean(axis=0)) / lasts)
    assert len(seen) >= 5
    assert min(seen) > 12.0


def test_a_single_sighting_is_off_by_more_than_a_metre_and_a_pass_with_true_poses_is_not(
    motorway_drives: Drives,
) -> None:
    single = np.concatenate([single_sighting_errors(world, drive) for world, drive in motorway_drives])
    oracle = [error for world, drive in motorway_drives for error in oracle_errors(world, drive).values()]
    assert np.mean(single) > 1.0
    assert np.median(single) > 1.0
    assert 0.3 < np.mean(oracle) < 0.9


def test_sign_types_are_sometimes_missing_and_sometimes_misread(motorway_drives: Drives) -> None:
    missing = wrong = total = 0
    for world, drive in motorway_drives:
        items = [item for record in drive.records if isinstance(record, DetectionFrame) for item in record.items]
        assert len(items) == drive.sightings.source.size
        for item, source in zip(items, drive.sightings.source.tolist(), strict=True):
            if source >= 0:
                total += 1
                missing += item.sign is None
                sign = world.signs[source]
                wrong += item.sign is not None and (item.sign, item.value) != (sign.sign, sign.value)
    assert 0.02 < missing / total < 0.2
    assert 0.01 < wrong / total < 0.05
