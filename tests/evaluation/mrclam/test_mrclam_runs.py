from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.drive import DetectionFrame, Odometry
from slamcu_core.geometry import compass_to_math
from slamcu_eval.mrclam import ARENA, RunParameters, edit_map, load_run
from slamcu_eval.mrclam.files import Landmark, read_landmarks, read_odometry, read_sightings, session_folder
from slamcu_eval.mrclam.runs import with_silent_frames

PARAMETERS = RunParameters()


def test_thinned_odometry_keeps_the_way_and_the_turn(recording: Path) -> None:
    _, records, _ = load_run(recording, 2, 1, 30.0)
    steps = [record for record in records if isinstance(record, Odometry)]
    raw = np.array(list(read_odometry(session_folder(recording, 2), 1)))
    held = np.diff(raw[:, 0])
    inside = raw[:-1, 0] < raw[0, 0] + 30.0
    kept = np.array([(step.speed, step.yaw_rate) for step in steps]).sum(axis=0) * PARAMETERS.odometry_period_s
    assert len(steps) == pytest.approx(300, abs=1)
    np.testing.assert_allclose(kept, (raw[:-1, 1:] * held[:, None])[inside].sum(axis=0), rtol=1e-3)


def test_records_come_in_order_of_time_and_within_the_duration(recording: Path) -> None:
    _, records, reference = load_run(recording, 2, 3, 20.0)
    times = [record.t for record in records]
    assert times == sorted(times)
    assert times[0] >= 0.0
    assert times[-1] <= 20.0
    assert reference[-1, 0] == pytest.approx(20.0, abs=0.1)


def test_a_later_stretch_is_the_same_recording_with_another_start(recording: Path) -> None:
    whole, records, reference = load_run(recording, 2, 3, 30.0)
    later, rest, poses = load_run(recording, 2, 3, 20.0, begin=10.0)
    shift = (later.start_time - whole.start_time).total_seconds()
    assert shift == pytest.approx(10.0, abs=0.5)
    np.testing.assert_allclose(
        poses[:, 0] + shift, reference[reference[:, 0] >= shift - 1e-6, 0][: len(poses)], atol=1e-5
    )
    whole_frames, frames = (
        {
            round(record.t + start, 3): record.items
            for record in some
            if isinstance(record, DetectionFrame) and record.items
        }
        for some, start in ((records, 0.0), (rest, shift))
    )
    assert frames.items() <= whole_frames.items()
    assert len(frames) == sum(t >= shift for t in whole_frames)
    assert later.sensors == whole.sensors


def test_other_robots_leave_a_frame_but_no_detection(recording: Path) -> None:
    _, records, _ = load_run(recording, 2, 1, 30.0, parameters=replace(PARAMETERS, silence_s=float("inf")))
    frames = [record for record in records if isinstance(record, DetectionFrame)]
    start = min(s.time for s in read_sightings(session_folder(recording, 2), 1))
    sightings = [s for s in read_sightings(session_folder(recording, 2), 1) if s.time <= start + 30.0]
    robots = [s for s in sightings if s.barcode <= 41]
    assert robots
    assert sum(len(frame.items) for frame in frames) == pytest.approx(len(sightings) - len(robots), abs=2)
    assert all(item.feature_class == "pole" for frame in frames for item in frame.items)
    looked = {round(frame.t, 2) for frame in frames}
    reference_start = load_run(recording, 2, 1, 30.0)[0].start_time.timestamp()
    assert all(any(abs(s.time - reference_start - t) < 0.02 for t in looked) for s in robots)


def test_detections_point_at_landmarks_from_the_reference_pose(recording: Path) -> None:
    header, records, reference = load_run(recording, 2, 2, 30.0)
    marks = np.array([(mark.x, mark.y) for mark in read_landmarks(session_folder(recording, 2))])
    axis = np.deg2rad(header.sensors[0].mount.yaw_deg)
    misses = []
    for frame in (record for record in records if isinstance(record, DetectionFrame)):
        x, y, heading = (np.interp(frame.t, reference[:, 0], reference[:, k]) for k in (1, 2, 3))
        for item in frame.items:
            assert item.range is not None
            assert item.bearing is not None
            angle = heading + axis + item.bearing
            place = np.array([x + item.range * np.cos(angle), y + item.range * np.sin(angle)])
            misses.append(np.hypot(*(marks - place).T).min())
    assert np.median(misses) < 0.15


def test_the_start_pose_errs_as_stated_and_by_seed(recording: Path) -> None:
    errors = []
    for seed in range(40):
        header, _, reference = load_run(recording, 2, 1, 1.0, rng=np.random.default_rng(seed))
        start = header.initial_pose
        errors.append(
            [
                *(ARENA.to_local(start.lon, start.lat) - reference[0, 1:3]),
                compass_to_math(start.heading_deg) - reference[0, 3],
            ]
        )
    spread = np.std(errors, axis=0)
    assert spread[:2] == pytest.approx([0.15, 0.15], rel=0.4)
    assert spread[2] == pytest.approx(0.08, rel=0.4)
    again = load_run(recording, 2, 1, 1.0, rng=np.random.default_rng(0))[0]
    assert again.initial_pose == load_run(recording, 2, 1, 1.0, rng=np.random.default_rng(0))[0].initial_pose


@given(gaps=st.lists(st.floats(0.2, 20.0), min_size=1, max_size=20))
def test_only_long_gaps_are_filled_and_no_frame_is_lost(gaps: list[float]) -> None:
    times = np.concatenate([[0.0], np.cumsum(gaps)]).tolist()
    filled = list(with_silent_frames([DetectionFrame(t, "camera") for t in times], PARAMETERS))
    steps = np.diff([frame.t for frame in filled])
    assert set(times) <= {frame.t for frame in filled}
    assert steps.max() <= PARAMETERS.silence_s + 1e-6
    short = sum(gap <= PARAMETERS.silence_s - 1e-6 for gap in gaps)
    assert len(filled) == len(times) or short < len(gaps)


@given(seed=st.integers(0, 2**32 - 1))
def test_an_edit_removes_three_and_adds_three_clear_of_all(seed: int) -> None:
    angle = np.linspace(0, 2 * np.pi, 15, endpoint=False)
    marks = [Landmark(6 + i, 3 * float(np.cos(a)), 3 * float(np.sin(a))) for i, a in enumerate(angle)]
    hd_map, truth = edit_map(marks, seed)
    kinds = [feature.truth for feature in truth]
    assert (kinds.count("normal"), kinds.count("deleted"), kinds.count("new")) == (12, 3, 3)
    assert {feature.object_id for feature in hd_map} == {f.object_id for f in truth if f.truth != "new"}
    places = np.array([(mark.x, mark.y) for mark in marks])
    for feature in truth:
        gap = np.hypot(*(places - (feature.x, feature.y)).T).min()
        assert gap >= 0.7 if feature.truth == "deleted" else gap == 0.0
    assert edit_map(marks, seed)[1] == truth
