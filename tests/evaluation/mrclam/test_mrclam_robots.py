from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slamcu_core.errors import FormatError
from slamcu_eval.fleet import VehicleError, drive_fleet
from slamcu_eval.mrclam.robots import Setting, edits_of, job_of, robots_of


def _jobs(setting: Setting) -> list:
    (edit,) = edits_of(setting)
    return [job_of(setting, edit, robot, edit.hd_map, None) for robot in robots_of(setting, 2)[:2]]


def test_robots_localize_and_classify_against_a_wrong_map(recording: Path) -> None:
    setting = Setting(recording, (2,), 40.0, edits=1, particles=50)
    told: dict[int, list[float]] = {}
    outcomes = drive_fleet(_jobs(setting), processes=2, tell=lambda run, share: told.setdefault(run, []).append(share))
    for run, outcome in enumerate(outcomes):
        assert outcome.pose_rmse_m < 0.3
        assert outcome.passes > 0
        assert {f.state for f in outcome.features if f.feature is not None} <= {"normal", "deleted"}
        assert outcome.step_ms.min() > 0.0
        assert told[run] == sorted(told[run])
        assert told[run][-1] == 1.0


def test_a_fleet_s_outcome_depends_on_the_seed_alone(recording: Path) -> None:
    setting = Setting(recording, (2,), 15.0, edits=1, particles=20)
    one, other = drive_fleet(_jobs(setting), processes=2), drive_fleet(_jobs(setting), processes=1)
    for a, b in zip(one, other, strict=True):
        assert a.features == b.features
        np.testing.assert_array_equal(a.pose_errors_m, b.pose_errors_m)
    (third, _) = drive_fleet(_jobs(replace(setting, seed=1)), processes=2)
    assert third.features != one[0].features


def test_a_robot_that_cannot_drive_stops_the_fleet_and_is_named(
    make_recording: Callable[..., Path], tmp_path: Path
) -> None:
    directory = make_recording(tmp_path, duration=10.0)
    (directory / "MRCLAM_Dataset2" / "Robot2_Odometry.dat").unlink()
    with pytest.raises(VehicleError, match=r"session 2, edit 1, robot 2: .*Robot2_Odometry.*University of Toronto"):
        drive_fleet(_jobs(Setting(directory, (2,), 10.0, edits=1)), processes=2)
    assert not multiprocessing.active_children()


def test_edits_differ_by_number_and_repeat_by_seed(recording: Path) -> None:
    setting = Setting(recording, (2,), 10.0, edits=3)
    edits = edits_of(setting)
    assert len({edit.truth for edit in edits}) == 3
    assert [edit.truth for edit in edits_of(setting)] == [edit.truth for edit in edits]
    assert [edit.truth for edit in edits_of(replace(setting, seed=9))] != [edit.truth for edit in edits]


def test_a_session_that_is_not_there_is_named(recording: Path) -> None:
    with pytest.raises(FormatError, match="MRCLAM_Dataset9"):
        edits_of(Setting(recording, (9,)))
