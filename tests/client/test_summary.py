"""What `slamcu-vehicle drive` prints: each feature is counted once, under what it is."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from slamcu_client.cli import main
from slamcu_client.summary import summary_lines
from slamcu_core.evidence import Masses
from slamcu_core.filter import FeatureEstimate
from slamcu_core.formats import read_results, write_drive_log, write_hd_map
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature, MapIdentity

MASSES = {"there": Masses(0.9, 0.05, 0.05), "not there": Masses(0.05, 0.9, 0.05), "undecided": Masses(0.2, 0.2, 0.6)}


def estimate(feature: MapFeature | None, state: str, masses: str = "there", passes: int = 1) -> FeatureEstimate:
    return FeatureEstimate(
        feature, state, MASSES[masses], 0.0, 2.1, 48.9, (0.1, 0.0, 0.1), passes, "traffic_sign", "STOP", None
    )


def mapped(number: int) -> MapFeature:
    return MapFeature(number, 2.1, 48.9, sign="STOP")


def watched(number: int) -> MapFeature:
    return replace(mapped(number), tile_id=-5)


def counts(lines: list[str]) -> dict[str, dict[str, int]]:
    """Read the summary back: by block, how many of each."""
    blocks: dict[str, dict[str, int]] = {}
    for line in lines:
        if line.startswith("  "):
            name, count = line[2:14].strip(), line[14:].split()[0]
            blocks[list(blocks)[-1]][name] = int(count)
        else:
            blocks[line] = {}
    return blocks


def test_each_feature_is_counted_once_where_it_belongs() -> None:
    estimates = [
        estimate(mapped(1), "normal"),
        estimate(mapped(2), "moved"),
        estimate(mapped(3), "modified"),
        estimate(mapped(4), "deleted", "not there"),
        estimate(mapped(5), "unclassified", "undecided"),
        estimate(mapped(6), "unclassified", "there", passes=0),
        estimate(None, "new"),
        estimate(None, "unclassified", "undecided"),
        estimate(watched(1), "new"),
        estimate(watched(2), "unclassified", "not there"),
        estimate(watched(3), "unclassified", "undecided"),
        estimate(watched(4), "unclassified", "undecided", passes=0),
    ]
    hd_map = HDMap([one.feature for one in estimates if one.feature], MapIdentity("town", "7"))
    lines = list(summary_lines(hd_map, estimates))
    assert counts(lines) == {
        "map town 7: 6 features": {"normal": 1, "deleted": 1, "moved": 1, "modified": 1, "unclassified": 2},
        "not in the map": {"new": 1, "unclassified": 1},
        "on watch for the cloud: 4 candidates": {"there": 1, "not there": 1, "undecided": 2},
    }
    assert "1 of them never in view" in "\n".join(lines)


@pytest.mark.parametrize("on_watch", [False, True])
def test_a_drive_past_changed_signs_is_summed_up_as_its_result_has_it(
    tmp_path: Path, drive, capsys: pytest.CaptureFixture[str], *, on_watch: bool
) -> None:
    """One sign shows another value than the map says; the cloud watches a place where nothing is."""
    frame = LocalFrame(2.1, 48.9)
    lon, lat = (float(part) for part in frame.to_geographic([250.0, -3.0]))
    features = [replace(one, value="30") if one.object_id == 2 else one for one in drive.hd_map]
    if on_watch:
        features.append(MapFeature(1, lon, lat, sign="SPEED_LIMIT", value="130", tile_id=-5))
    (tmp_path / "map.geojson").write_text("".join(write_hd_map(MapIdentity("road", "2"), features)))
    (tmp_path / "drive.jsonl").write_text("".join(write_drive_log(drive.header, drive.records)))
    result = tmp_path / "result.geojson"
    command = ["drive", "--map", str(tmp_path / "map.geojson"), "--log", str(tmp_path / "drive.jsonl")]
    assert main([*command, "--result", str(result)]) == 0
    blocks = counts(capsys.readouterr().out.splitlines()[1:])
    with result.open() as file:
        written = Counter(one.state.value for one in read_results(file) if one.map_object_id is not None)
    (of_the_map,) = (block for title, block in blocks.items() if title.startswith("map "))
    assert of_the_map == {name: written[name] for name in of_the_map}
    assert of_the_map["modified"] == 1
    assert sum(of_the_map.values()) == len(drive.hd_map)
    assert f"map road 2: {len(drive.hd_map)} features" in blocks
    watch = [block for title, block in blocks.items() if "on watch" in title]
    assert watch == ([{"there": 0, "not there": 1, "undecided": 0}] if on_watch else [])
