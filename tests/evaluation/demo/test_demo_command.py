from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from slamcu_eval.cli import run

from slamcu_core.formats import read_results, read_truth


@pytest.mark.slow
def test_the_demo_fuses_a_fleet_draws_the_road_and_accepts_a_change(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--vehicles", "3", "--seed", "3", "--length-km", "2.5", "--out", str(tmp_path)]
    assert run(["demo", *options]) == 0
    said = capsys.readouterr()

    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    with (tmp_path / "truth.geojson").open("rb") as file:
        true = list(read_truth(file))
    with (tmp_path / "result.geojson").open("rb") as file:
        told = list(read_results(file))
    mapped = {feature.map_object_id for feature in true} - {None}
    assert {feature.map_object_id for feature in told} - {None} == mapped
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["vehicles"] == 3
    assert figures["fleet"]["features"] == len(true)
    assert figures["one_car"]["features"] == 3 * len(true)
    assert figures["messages"] > 0

    assert re.search(r"Change \d+ accepted through the API", said.out)
    assert re.search(r"curl .*\$URL/v1/changes/\d+ ", said.out)
    assert "the server has stopped, and its data are gone" in said.err
