from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from slamcu_eval.cli import run

KINDS = {"normal", "deleted", "new"}


def test_the_command_scores_robots_alone_and_as_a_fleet(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "figures.json"
    options = ["--sessions", "2", "--duration", "40", "--edits", "1", "--particles", "50", "--json", str(file)]
    assert run(["mrclam", str(recording), *options]) == 0
    figures = json.loads(file.read_text())
    assert set(figures) == {"sessions", "pooled", "step_ms", "machine"}
    assert set(figures["sessions"]) == {"2"}
    for block in (figures["sessions"]["2"], figures["pooled"]):
        single, fused = block["single"], block["fused"]
        assert single["runs"] == 5
        assert {"diverged_runs", "false_new_per_run", "pose_rmse_median_m", "new_position_error_m"} <= set(single)
        assert {"confusion", "accuracy", "false_new", "new_position_error_m"} <= set(fused)
        for confusion, features in ((single["confusion"], 5 * 18), (fused["confusion"], 18)):
            assert set(confusion) == KINDS
            assert sum(sum(row.values()) for row in confusion.values()) == features
        assert sum(fused["confusion"]["normal"].values()) == 12
        # the arena is easy, so that the fleet must find what single robots find, and no more
        assert single["accuracy"] > 0.7
        assert fused["accuracy"] >= 16 / 18
        assert fused["false_new"] == 0
    assert "the fleet: right" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ([], r"nowhere.*not found.*University of Toronto.*educational use"),
        (["--sessions", "two"], "--sessions takes numbers with commas"),
        (["--sessions", "2", "--begin", "9000"], r"Reference.csv: expected poses 9000 s after .* ends after \d+ s"),
    ],
)
def test_bad_input_gets_one_clear_line(
    options: list[str], complaint: str, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    directory = recording if options else tmp_path / "nowhere"
    assert run(["mrclam", str(directory), *options]) == 1
    said = capsys.readouterr().err.strip()
    assert said.startswith("slamcu-eval: ")
    assert "\n" not in said
    assert re.search(complaint, said)
