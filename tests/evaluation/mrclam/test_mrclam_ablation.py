from __future__ import annotations

import json
from pathlib import Path

import pytest

from slamcu_eval.ablation import FULL
from slamcu_eval.cli import run


def test_the_command_drives_recorded_robots_too(
    tmp_path: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "ablation.json"
    options = ["--drives", "0", "--mrclam", str(recording), "--sessions", "2", "--duration", "20", "--particles", "20"]
    assert run(["ablation", *options, "--only", "motion_prior", "--jobs", "2", "--json", str(file)]) == 0
    robots = json.loads(file.read_text())["robots"]
    assert set(robots) == {FULL, "motion_prior"}
    assert robots[FULL]["drives"] == 5
    assert robots["motion_prior"]["features"] == 5 * 18
    assert "What each part is worth: robots" in capsys.readouterr().out
