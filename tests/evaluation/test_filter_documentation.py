"""docs/filter.md names what the filter has, and the script that measures its figures refuses what it does not know."""

from __future__ import annotations

import os
import re
import subprocess
from dataclasses import fields
from pathlib import Path

import pytest

from slamcu_core.filter import FilterParameters
from slamcu_core.reports import Health

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/filter.md").read_text(encoding="utf-8")
_NO_STEP = {
    "__init__",
    "parameters",
    "particles",
    "table",
    "passes",
    "estimates",
    "beliefs",
    "slamcu",
    "frame_update",
    "scratch",
}


@pytest.mark.parametrize("name", [item.name for item in (*fields(FilterParameters), *fields(Health))])
def test_every_parameter_and_every_sign_of_health_is_explained(name: str) -> None:
    assert f"`{name}`" in TEXT


@pytest.mark.parametrize(
    "module", sorted({path.stem for path in (ROOT / "slamcu_core/filter").glob("*.py")} - _NO_STEP)
)
def test_every_part_of_a_step_has_its_place_in_the_order(module: str) -> None:
    assert f"`{module}`" in TEXT


def test_the_equations_stand_where_the_table_says() -> None:
    rows = re.findall(r"^\| ([0-9, –]+) \| [^|]+ \| ([^|]+) \|$", TEXT, re.MULTILINE)
    numbers: list[int] = []
    for equations, where in rows:
        first, *rest = map(int, re.findall(r"\d+", equations))
        numbers += range(first, (rest or [first])[-1] + 1)
        for path, names in re.findall(r"`([a-z_/]+\.py)` \(([^)]+)\)", where):
            source = (ROOT / "slamcu_core" / path).read_text(encoding="utf-8")
            for name in re.findall(r"`(\w+)`", names):
                assert re.search(rf"(def|class) {name}\b", source), f"{path} has no {name}"
    assert numbers == list(range(1, 21))


def _figures(*stages: str) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name != "MRCLAM_DIR"}
    return subprocess.run(
        [ROOT / "scripts/figures", *stages], capture_output=True, text=True, env=environment, check=False
    )


def test_an_unknown_stage_is_refused_before_anything_is_measured() -> None:
    done = _figures("mrclam", "everything")
    assert done.returncode == 2
    known = "paper, mrclam, ablation, law, fleet, attack and plots"
    assert done.stderr == f"figures: no stage everything; there are {known}\n"


def test_without_the_recordings_the_robots_are_left_out_and_that_is_said() -> None:
    done = _figures("mrclam")
    assert done.returncode == 0
    assert "MRCLAM_DIR is not set, so the recorded robots are left out" in done.stderr
