"""The paper's experiment: the real filter over simulated drives, every figure of the contract, nothing dropped."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from slamcu_eval.cli import run
from slamcu_eval.highway import HighwayParameters, simulate
from slamcu_eval.oracle import place_by_least_squares
from slamcu_eval.paper import Outcome, paper_figures, run_drives, world_seed

SHORT = HighwayParameters().having(length_m=2_500.0, normal=8, deleted=3, new=6)
KEYS = {
    "drives",
    "features",
    "confusion",
    "accuracy",
    "accuracy_ci95",
    "false_new_per_drive",
    "never_in_view",
    "new_position_error_m",
    "oracle_error_m",
    "ellipse95_coverage",
    "localization_rmse_m",
    "diverged_drives",
    "step_ms",
    "particles",
}


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    return run_drives(3, 1, 100, parameters=SHORT)


def test_every_feature_of_every_drive_counts(outcomes: list[Outcome]) -> None:
    figures = paper_figures(outcomes, 100)
    assert figures.keys() >= KEYS
    assert figures["features"] == 3 * 17
    assert {truth: sum(row.values()) for truth, row in figures["confusion"].items()} == {
        "normal": 24,
        "deleted": 9,
        "new": 18,
    }
    right = sum(figures["confusion"][kind][kind] for kind in figures["confusion"])
    assert figures["accuracy"] == pytest.approx(right / 51)
    assert figures["accuracy_ci95"][0] <= figures["accuracy"] <= figures["accuracy_ci95"][1]
    low, high = figures["error_over_oracle"]["ci95"]
    assert low <= figures["error_over_oracle"]["ratio"] <= high
    assert figures["error_over_oracle"]["ratio"] == pytest.approx(
        figures["new_position_error_m"]["mean"] / figures["oracle_error_m"]["mean"]
    )
    assert figures["new_position_error_m"].keys() == {"mean", "median", "p95", "std"}
    assert figures["step_ms"].keys() == {"mean", "p50", "p99"}


def test_the_filter_tells_most_features_and_keeps_its_way(outcomes: list[Outcome]) -> None:
    figures = paper_figures(outcomes, 100)
    assert figures["accuracy"] > 0.8
    # 80 s hold one look at the satellites' bias of 1.5 m an axis and a handful of signs: some drives end beyond 3 m
    assert figures["localization_rmse_m"] < 5.0
    assert figures["oracle_error_m"]["mean"] < figures["single_sighting_error_m"]["mean"]


def test_diverged_drives_are_counted_named_and_kept(outcomes: list[Outcome]) -> None:
    outcomes = [replace(outcome, pose_errors_m=(1.0, 2.0)) for outcome in outcomes]
    lost = replace(outcomes[0], pose_errors_m=(50.0, 70.0))
    figures = paper_figures([lost, *outcomes[1:]], 100)
    assert figures["diverged_drives"] == 1
    assert figures["diverged_names"] == [lost.name]
    assert figures["drives"] == 3
    assert figures["features"] == 3 * 17
    assert figures["localization_rmse_m"] > 3.0


def test_a_drive_without_a_pose_is_diverged(outcomes: list[Outcome]) -> None:
    assert replace(outcomes[0], pose_errors_m=(math.nan,)).diverged


def test_running_in_parallel_changes_nothing_but_the_time(outcomes: list[Outcome]) -> None:
    finished = []
    parallel = run_drives(2, 1, 100, jobs=2, parameters=SHORT, done=lambda: finished.append(1))
    assert len(finished) == 2
    assert [o.score for o in parallel] == [o.score for o in outcomes[:2]]
    assert [o.pose_errors_m for o in parallel] == [o.pose_errors_m for o in outcomes[:2]]


def test_drives_of_different_experiments_share_no_world() -> None:
    seeds = {world_seed(seed, drive) for seed in range(20) for drive in range(50)}
    assert len(seeds) == 1_000


def test_least_squares_with_true_poses_is_exact_without_noise() -> None:
    _, (drive,) = simulate(0, 1, length_m=1_000.0, normal=1, deleted=0, new=0)
    sensor = drive.header.sensors[0]
    camera = np.column_stack([np.linspace(0.0, 40.0, 20), np.zeros(20), np.full(20, 0.02)])
    place = np.array([62.0, -7.0])
    delta = place - camera[:, :2]
    distance, bearing = np.hypot(delta[:, 0], delta[:, 1]), np.arctan2(delta[:, 1], delta[:, 0]) - 0.02
    assert place_by_least_squares(camera, distance, bearing, sensor) == pytest.approx(place, abs=1e-6)
    noise = np.random.default_rng(0).normal(size=(200, 2, 20))
    errors = [
        place_by_least_squares(camera, distance + 2.0 * n[0], bearing + 0.006 * n[1], sensor) - place for n in noise
    ]
    assert np.abs(np.mean(errors, axis=0)).max() < 0.1
    assert np.linalg.norm(errors, axis=1).mean() < 0.6  # a twentieth of the measurements' own 2 m and more


def test_the_command_writes_the_contract_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamcu_eval.commands.paper.run_drives", partial(run_drives, parameters=SHORT))
    file = tmp_path / "paper.json"
    assert run(["paper", "--drives", "1", "--seed", "3", "--particles", "20", "--json", str(file)]) == 0
    figures = json.loads(file.read_text())
    assert figures.keys() >= KEYS
    assert figures["features"] == 17
    assert figures["particles"] == 20
    table = capsys.readouterr().out
    assert "96.12%" in table
    assert "30.39 ms" in table
