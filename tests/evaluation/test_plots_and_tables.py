"""Plots and tables: made from the commands' JSON alone, and the documentation is in step with the committed results."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from slamcu_core.errors import FormatError
from slamcu_eval.cli import run
from slamcu_eval.commands.plots import read_results
from slamcu_eval.console import write_json
from slamcu_eval.curves import feature_curves
from slamcu_eval.highway import HighwayParameters
from slamcu_eval.paper import Outcome, paper_figures, run_drives
from slamcu_eval.records import NOTHING, FeatureRecord, read_records, write_records
from slamcu_eval.tables import TABLES, fill

ROOT = Path(__file__).parents[2]
DOCUMENTS = ("docs/filter.md", "docs/fleet.md", "docs/attacks.md", "docs/decisions/0005-proposals-and-association.md")
SHORT = HighwayParameters().having(length_m=2_000.0, normal=8, deleted=3, new=6, encounter_interval_s=10.0)


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    return run_drives(2, 7, 40, parameters=SHORT)


def _records(outcomes: list[Outcome]) -> list[FeatureRecord]:
    return [record for outcome in outcomes for record in outcome.records]


def test_there_is_a_record_of_every_feature_and_every_false_claim(outcomes: list[Outcome]) -> None:
    for number, outcome in enumerate(outcomes):
        of_world = [record for record in outcome.records if record.truth != NOTHING]
        assert [(record.truth, record.predicted) for record in of_world] == list(outcome.score.said)
        assert len(outcome.records) - len(of_world) == len(outcome.score.false_new)
        assert {record.drive for record in outcome.records} == {number}
        errors = [record.position_error_m for record in of_world if record.position_error_m is not None]
        assert sorted(errors) == sorted(match.error_m for match in outcome.score.matches)


def test_a_record_is_consistent_with_itself(outcomes: list[Outcome]) -> None:
    records = _records(outcomes)
    for record in records:
        if record.exists is not None:
            assert record.exists + record.not_exists + record.unknown == pytest.approx(1.0)
        if record.sightings:
            assert record.truth in {"normal", "new"}
            assert record.closest_m <= record.closest_detection_m <= record.first_detection_m <= 80.0
            assert record.hidden_share < 1.0
            assert record.sightings <= record.frames_in_view
        if record.position_error_m is not None:
            assert record.predicted == "new"
            assert record.mahalanobis_square >= 0.0
    assert any(record.hidden_share for record in records)
    covered = [r.mahalanobis_square <= 5.991464547107979 for r in records if r.mahalanobis_square is not None]
    assert sum(covered) / len(covered) == pytest.approx(paper_figures(outcomes, 40)["ellipse95_coverage"])


def test_records_survive_their_file_and_a_bad_line_is_named(outcomes: list[Outcome], tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    write_records(path, _records(outcomes))
    assert read_records(path) == _records(outcomes)
    path.write_text(path.read_text() + '{"drive": 1}\n')
    with pytest.raises(
        FormatError, match=rf"records.jsonl, line {len(_records(outcomes)) + 1}: expected a feature record"
    ):
        read_records(path)


def test_curves_lose_no_feature_that_was_in_view(outcomes: list[Outcome]) -> None:
    records = _records(outcomes)
    curves = feature_curves(records)
    for name in ("accuracy_by_range", "accuracy_by_hidden_share"):
        for kind, points in curves[name].items():
            of_kind = [record for record in records if record.truth == kind and record.frames_in_view]
            assert sum(point["count"] for point in points) == len(of_kind)
            right = sum(point["count"] * point["accuracy"] for point in points)
            assert right == pytest.approx(sum(record.predicted == kind for record in of_kind))
    assert sum(point["found"] for point in curves["error_by_sightings"]) == sum(
        record.position_error_m is not None for record in records
    )


def test_reliability_compares_belief_with_what_stood() -> None:
    stood = FeatureRecord(0, "normal", "normal", 9, 0.0, 20.0, 5, 60.0, 20.0, 0.9, 0.0, 0.1, None, None, None)
    gone = replace(stood, truth="deleted")
    doubted = replace(gone, predicted="deleted", exists=0.1, not_exists=0.9, unknown=0.0)
    claim = replace(stood, truth=NOTHING, predicted="new")
    unproven = replace(claim, predicted="unclassified")
    points = feature_curves([stood, stood, gone, doubted, claim, unproven])["reliability"]
    assert [(p["count"], p["stood"]) for p in points] == [(1, 0.0), (4, 0.5)]
    assert points[1]["belief"] == pytest.approx(0.95)


@pytest.fixture(scope="module")
def results(outcomes: list[Outcome], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    write_json(folder / "paper.json", paper_figures(outcomes, 40))
    curve = {"step_ms": {"1": 0.5, "10": 0.5, "100": 0.6}}
    memory = {"hours": [0.0, 1.0, 2.0], "memory_mb": [0.5, 1.0, 1.0]}
    write_json(folder / "bench-curves.json", {"map_size": curve, "drive_length": curve, "memory": memory})
    return folder


def test_plots_are_drawn_from_results_alone_and_alike_every_time(results: Path, tmp_path: Path) -> None:
    for out in ("one", "two"):
        assert run(["plots", "--results", str(results), "--out", str(tmp_path / out)]) == 0
    names = {path.name for path in (tmp_path / "one").iterdir()}
    assert names == {"accuracy.png", "position-error.png", "reliability.png", "step-time.png"}
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_tables_stand_between_their_marks_and_gaps_name_their_stage(results: Path, tmp_path: Path) -> None:
    document = tmp_path / "text.md"
    old = "<!-- begin paper -->\nwhat was measured last year\n<!-- end paper -->\n"
    document.write_text(f"before\n{old}after\n<!-- begin robots -->\n<!-- end robots -->\n")
    command = ["plots", "--results", str(results), "--out", str(tmp_path), "--tables", str(document)]
    assert run(command) == 0
    text = document.read_text()
    assert text.startswith("before\n<!-- begin paper -->\n| figure | here | published 2018 |\n")
    assert "last year" not in text
    assert "96.12 %" in text
    assert "`scripts/figures mrclam` fills this table" in text
    assert run(command) == 0
    assert document.read_text() == text


def test_a_mark_without_a_table_is_an_error() -> None:
    with pytest.raises(FormatError, match=r"text.md: expected a mark of paper, .*, got nonsense"):
        fill("<!-- begin nonsense -->\n<!-- end nonsense -->\n", {}, source="text.md")


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_documentation_says_what_the_committed_results_say(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    assert re.search(r"<!-- begin [a-z-]+ -->", text)
    assert fill(text, read_results(ROOT / "docs/results"), source=name) == text


def test_every_table_is_in_the_documentation() -> None:
    text = "".join((ROOT / name).read_text(encoding="utf-8") for name in DOCUMENTS)
    assert set(re.findall(r"<!-- begin ([a-z0-9-]+) -->", text)) == set(TABLES)


def test_a_broken_result_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "paper.json").write_text("{")
    assert run(["plots", "--results", str(tmp_path), "--out", str(tmp_path)]) == 1
    assert "paper.json: expected JSON" in capsys.readouterr().err


def _strings(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [text for item in value.values() for text in _strings(item)]
    return [text for item in value for text in _strings(item)] if isinstance(value, list) else [str(value)]


def test_committed_results_name_their_machine_and_nothing_of_its_owner() -> None:
    for path in (ROOT / "docs/results").glob("*.json"):
        figures = json.loads(path.read_text(encoding="utf-8"))
        assert {"processor", "processors", "python"} <= set(figures["machine"]), path.name
        assert not [text for text in _strings(figures["machine"]) if "/" in text], path.name
