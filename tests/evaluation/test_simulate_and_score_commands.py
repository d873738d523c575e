"""The commands `simulate` and `score`: files as the formats have them, and one line for every mistake."""

from __future__ import annotations

import csv
import gzip
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slamcu_core.formats.drive_log import read_drive_log
from slamcu_core.formats.hd_map import load_hd_map
from slamcu_core.formats.results import ChangeState, ResultFeature, read_truth, write_results
from slamcu_eval.cli import run
from slamcu_eval.highway import simulate
from slamcu_eval.highway.files import truth_features

COUNTS = {"normal": 6, "deleted": 2, "new": 4, "moved": 2, "modified": 2}
OPTIONS = ["--length-km", "2.5", *(part for kind, n in COUNTS.items() for part in (f"--{kind}", str(n)))]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "highway"
    assert run(["simulate", "highway", "--seed", "9", "--vehicles", "2", "--out", str(folder), *OPTIONS]) == 0
    return folder


def test_files_hold_what_the_simulation_has_in_memory(simulated: Path) -> None:
    world, drives = simulate(9, 2, length_m=2_500.0, **COUNTS)
    with (simulated / "map.geojson").open("rb") as file:
        hd_map = load_hd_map(file)
    assert hd_map.identity == world.hd_map.identity
    assert list(hd_map) == list(world.hd_map)
    with (simulated / "truth.geojson").open("rb") as file:
        assert list(read_truth(file)) == list(truth_features(world))
    for drive in drives:
        with gzip.open(simulated / "drives" / f"{drive.header.vehicle_id}.jsonl.gz", "rb") as file:
            header, records = read_drive_log(file)
            assert header == drive.header
            assert tuple(records) == drive.records


def test_truth_has_every_kind_with_what_its_kind_needs(simulated: Path) -> None:
    with (simulated / "truth.geojson").open("rb") as file:
        truth = list(read_truth(file))
    assert {kind: sum(f.truth.value == kind for f in truth) for kind in COUNTS} == COUNTS
    for feature in truth:
        assert (feature.from_lonlat is not None) == (feature.truth is ChangeState.MOVED)
        assert (feature.map_sign is not None) == (feature.truth is ChangeState.MODIFIED)
        assert (feature.map_object_id is None) == (feature.truth is ChangeState.NEW)


def test_reference_poses_lie_beside_the_logs(simulated: Path) -> None:
    _, drives = simulate(9, 2, length_m=2_500.0, **COUNTS)
    for drive in drives:
        with (simulated / "reference" / f"{drive.header.vehicle_id}.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        t = np.array([float(row["t"]) for row in rows])
        assert np.allclose(np.diff(t), 0.1)
        lat = np.interp(t, drive.reference.t, drive.reference.lat)
        assert np.allclose([float(row["lat"]) for row in rows], lat, atol=1e-8)


def test_equal_seeds_give_equal_bytes(simulated: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    assert run(["simulate", "highway", "--seed", "9", "--vehicles", "2", "--out", str(again), *OPTIONS]) == 0
    files = sorted(path.relative_to(simulated) for path in simulated.rglob("*") if path.is_file())
    assert len(files) == 6
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert all((simulated / path).read_bytes() == (again / path).read_bytes() for path in files)


def test_a_second_simulation_does_not_mix_with_the_first(simulated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", "highway", "--out", str(simulated)]) == 1
    assert "is not empty" in _one_line(capsys)


def test_describe_measures_the_sensor_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["simulate", "highway", "--describe", "--json", "sensor.json"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["sensor.json"]
    figures = json.loads(Path("sensor.json").read_text())
    assert figures["single_sighting_error_m"]["mean"] > 1.0
    assert figures["detection_probability"] <= 0.9
    assert "single sighting" in capsys.readouterr().out


def _claims(truth: Path, *, right: bool) -> list[ResultFeature]:
    with truth.open("rb") as file:
        return [
            ResultFeature(
                state=feature.truth if right else ChangeState.NORMAL,
                lon=feature.lon,
                lat=feature.lat,
                mass_exists=0.5,
                mass_not_exists=0.2,
                mass_unknown=0.3,
                covariance_m2=(1.0, 0.0, 1.0),
                passes=1,
                map_object_id=feature.map_object_id,
                sign=feature.sign,
                value=feature.value,
            )
            for feature in read_truth(file)
            if right or feature.map_object_id is not None
        ]


@pytest.mark.parametrize("right", [True, False])
def test_scoring_files(simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], *, right: bool) -> None:
    truth, result, out = simulated / "truth.geojson", tmp_path / "result.geojson", tmp_path / "score.json"
    result.write_text("".join(write_results(_claims(truth, right=right))))
    assert run(["score", "--truth", str(truth), "--result", str(result), "--json", str(out)]) == 0
    figures = json.loads(out.read_text())
    assert figures["features"] == 16
    assert figures["accuracy"] == (1.0 if right else 6 / 16)
    assert figures["false_new"] == 0
    assert figures["new_position_error_m"]["mean"] == (0.0 if right else None)  # a figure that does not exist is null
    assert figures["confusion"]["deleted"]["deleted" if right else "normal"] == 2
    assert "accuracy" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["simulate", "highway"], 2, "--out"),
        (["simulate", "highway", "--vehicles", "0", "--out", "x"], 2, "--vehicles"),
        (["simulate", "highway", "--length-km", "1", "--out", "x"], 1, "too short for 103 signs"),
        (["simulate", "railway"], 2, "railway"),
        (["paper", "--particles", "many"], 2, "--particles"),
        (["score", "--truth", "nowhere.geojson", "--result", "nowhere.geojson"], 1, "nowhere.geojson: No such file"),
        (["frobnicate"], 2, "frobnicate"),
    ],
)
def test_mistakes_get_one_line(
    *,
    arguments: list[str],
    code: int,
    says: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == code
    assert says in _one_line(capsys)
    assert list(tmp_path.iterdir()) == []


def test_a_bad_result_file_is_named_with_line_and_field(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.geojson"
    bad.write_text("".join(write_results(_claims(simulated / "truth.geojson", right=True))).replace("0.3", '"much"', 1))
    assert run(["score", "--truth", str(simulated / "truth.geojson"), "--result", str(bad)]) == 1
    line = _one_line(capsys)
    assert "bad.geojson, line 3" in line
    assert "mass_unknown" in line


def test_the_installed_command_fails_in_one_line_too() -> None:
    command = Path(sys.executable).with_name("slamcu-eval")
    done = subprocess.run(
        [command, "score", "--truth", "none", "--result", "none"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr == "slamcu-eval: none: No such file or directory\n"


def _one_line(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("slamcu-eval: ")
    return lines[0]
