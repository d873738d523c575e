"""What many cars add: recordings that another server can hear, figures that count as they say, and a small fleet."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from slamcu_core.errors import SlamcuError
from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_core.reports import DetectionStatus, MapReference, MeasuredPosition, PassReport, ReportMessage
from slamcu_eval.cli import run
from slamcu_eval.highway import make_world
from slamcu_eval.many.experiment import RoadResult
from slamcu_eval.many.figures import KINDS, balanced_ece, fleet_figures
from slamcu_eval.many.reading import Reading, Statement
from slamcu_eval.many.recording import Recording, translation
from slamcu_eval.many.roads import road_parameters
from slamcu_eval.score import Claim

START = datetime(2026, 11, 1, 8, tzinfo=UTC)
WATCH = MapFeature(object_id=5, lon=2.1, lat=48.9, sign="SPEED_LIMIT", value="80", tile_id=-1)


def _recording(*, watched: tuple[MapFeature, ...] = (WATCH,)) -> Recording:
    seen = PassReport(
        START,
        START,
        DetectionStatus.EXPECTED_AND_DETECTED,
        3.0,
        0.0,
        sign="SPEED_LIMIT",
        value="80",
        reference=MapReference(-1, 5),
        position=MeasuredPosition(2.1, 48.9, (0.5, 0.1, 0.4)),
        frames_detected=9,
    )
    message = ReportMessage("s", 1, (seen,), last_of_session=True, map_identity=MapIdentity("m", "1"))
    claim = Claim("new", (1.0, 2.0), (0.5, 0.1, 0.4), sign="SPEED_LIMIT", value="80", passes=1)
    return Recording((message,), watched, (claim,), {3: (1.5, 2.5)}, 0.7)


def test_what_a_car_told_is_read_as_it_was_written(tmp_path: Path) -> None:
    told = _recording()
    assert Recording.read(tmp_path / "car") is None
    told.write(tmp_path / "car")
    assert Recording.read(tmp_path / "car") == told
    (tmp_path / "car.json").write_text("{}")
    with pytest.raises(SlamcuError, match="remove it to drive again"):
        Recording.read(tmp_path / "car")


def test_a_watch_feature_of_another_server_is_known_by_place_and_type() -> None:
    near = replace(WATCH, object_id=77, lat=48.90001)  # 1.1 m north
    other_type = replace(WATCH, object_id=78, value="90")
    far = replace(WATCH, object_id=79, lat=48.9001)
    assert translation([WATCH], [far, other_type, near]) == {5: near}
    assert translation([WATCH], [far, other_type]) == {}
    assert translation([], [near]) == translation([WATCH], []) == {}


def test_calibration_weighs_what_exists_and_what_does_not_half_each() -> None:
    assert balanced_ece([(1.0, True)] * 99 + [(0.0, False)]) == 0.0
    assert balanced_ece([(1.0, True)] * 99 + [(1.0, False)]) == pytest.approx(0.5)
    assert balanced_ece([(0.5, True), (0.5, False)]) == pytest.approx(0.0)
    assert np.isnan(balanced_ece([(0.5, True)]))


def _truth_told(seed: int) -> RoadResult:
    """Return a road of which everything is told as it is."""
    world = make_world(seed, road_parameters(common_bias=False, length_m=3_000.0).world)
    statements = []
    for sign in world.signs:
        kind = sign.truth.value
        place = sign.place or sign.map_place
        assert place is not None
        claim = Claim(kind, place, (0.04, 0.0, 0.04), sign.map_object_id, sign.sign, sign.value, 5)
        statements.append(Statement(claim, 1.0 if kind in ("normal", "new") else 0.0, 2, 5))
    return RoadResult(world, (Reading(5, tuple(statements)),), (_recording(),))


def test_the_truth_scores_full_marks_and_every_error_costs_its_own_kind() -> None:
    result = _truth_told(3)
    block = fleet_figures([result], common_bias=False)["vehicles"]["5"]
    for kind in KINDS:
        assert (block[kind]["precision"], block[kind]["recall"]) == (1.0, 1.0)
    assert block["new_position_error_m"]["mean"] == 0.0
    assert block["ellipse95_coverage"] == 1.0
    assert block["passes_to_decision"]["new"] == {"median": 2.0, "p95": 2.0}
    assert block["ece"]["deleted"] == 0.0

    told = list(result.readings[0].statements)
    kinds = [one.claim.state for one in told]
    spoiled = list(told)
    new, deleted, moved = (kinds.index(kind) for kind in ("new", "deleted", "moved"))
    x, y = told[new].claim.place
    spoiled[new] = replace(told[new], claim=replace(told[new].claim, place=(x + 0.3, y + 0.4)))
    spoiled[deleted] = replace(told[deleted], claim=replace(told[deleted].claim, state="normal"))
    x, y = told[moved].claim.place
    spoiled[moved] = replace(told[moved], claim=replace(told[moved].claim, place=(x + 4.0, y)))  # it is not there
    ghost = Claim("new", (1e4, 1e4), (0.04, 0.0, 0.04))
    spoiled.append(Statement(ghost, 0.9, 2, 2))
    reading = Reading(5, tuple(spoiled))
    block = fleet_figures([replace(result, readings=(reading,))], common_bias=False)["vehicles"]["5"]
    true = {kind: kinds.count(kind) for kind in KINDS}
    assert block["new"]["precision"] == pytest.approx(true["new"] / (true["new"] + 1))
    assert block["new"]["recall"] == 1.0
    assert block["deleted"]["recall"] == pytest.approx(1.0 - 1.0 / true["deleted"])
    assert block["deleted"]["precision"] == 1.0
    assert block["moved"]["precision"] == block["moved"]["recall"] == pytest.approx(1.0 - 1.0 / true["moved"])
    assert block["new_position_error_m"]["mean"] == pytest.approx(0.5 / true["new"])
    assert block["ece"]["new"] > 0.0
    assert (block["new_phantoms"], block["unverified_candidates"]) == (1, 0)
    unverified = Reading(5, (*told, Statement(ghost, 0.9, None, 1)))
    block = fleet_figures([replace(result, readings=(unverified,))], common_bias=False)["vehicles"]["5"]
    assert block["unverified_candidates"] == 1
    assert Reading.from_document(json.loads(json.dumps(reading.to_document()))) == reading


def test_a_small_fleet_is_heard_by_a_real_server_and_need_not_drive_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    work, out = tmp_path / "work", tmp_path / "fleet.json"
    options = ["--vehicles", "1,3", "--roads", "1", "--length-km", "1.5", "--seed", "1", "--work", str(work)]
    assert run(["fleet", *options, "--json", str(out)]) == 0
    figures = json.loads(out.read_text())
    assert set(figures["vehicles"]) == {"1", "3"}
    for block in figures["vehicles"].values():
        assert set(block) >= {*KINDS, "new_position_error_m", "ellipse95_coverage", "passes_to_decision", "ece"}
    assert figures["vehicles"]["3"]["new"]["true"] == figures["features_of_each_kind"]["new"] == 6
    assert figures["vehicles"]["3"]["new"]["right"] >= 1
    assert figures["common_bias"] is False

    # the readings are kept: the same figures without a car or a server
    before = {path: path.stat().st_mtime_ns for path in work.rglob("car-*")}
    assert run(["fleet", *options, "--json", str(out)]) == 0
    assert json.loads(out.read_text())["vehicles"] == figures["vehicles"]
    assert {path: path.stat().st_mtime_ns for path in work.rglob("car-*")} == before

    # processes that share a folder have roads of their own
    (work / "road-00").rename(work / "road-01")
    assert run(["fleet", *options, "--first-road", "1", "--json", str(out)]) == 0
    assert json.loads(out.read_text())["roads"] == 1
    assert [path.name for path in work.iterdir()] == ["road-01"]
    capsys.readouterr()

    assert run(["fleet", "--vehicles", "many"]) == 1
    assert "whole numbers" in capsys.readouterr().err


def test_roads_are_mostly_as_mapped_and_the_common_bias_is_asked_for() -> None:
    world = make_world(1, road_parameters(common_bias=False).world)
    mapped = [sign for sign in world.signs if sign.map_object_id is not None]
    assert sum(sign.truth.value == "normal" for sign in mapped) > 0.7 * len(mapped)
    moves = [np.hypot(*np.subtract(s.place, s.map_place)) for s in world.signs if s.truth.value == "moved"]
    assert min(moves) > 2.0
    assert max(moves) < 17.0
    assert road_parameters(common_bias=True).camera.common_range_bias == 0.02
    assert road_parameters(common_bias=False).camera.common_range_bias == 0.0
