from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable
from importlib.metadata import Distribution, distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]


def _closure(wanted: Iterable[str], there: dict[str, Distribution]) -> set[str]:
    """What these distributions need, themselves included."""
    found: set[str] = set()
    waiting = list(wanted)
    while waiting:
        name = canonicalize_name(waiting.pop())
        if name not in found:
            found.add(name)
            needed = [Requirement(line) for line in there[name].requires or ()]
            waiting += [each.name for each in needed if each.marker is None or each.marker.evaluate({"extra": ""})]
    return found


@pytest.mark.slow
def test_a_clean_environment_gets_the_client_and_nothing_of_the_server(tmp_path: Path) -> None:
    """What the README tells a vehicle developer to type, in an environment that has nothing."""
    venv = tmp_path / "venv"
    # our pip installs into it: to give it one of its own takes as long as the rest
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    python = venv / "bin" / "python"
    # from the root of the tree, as a reader types it, with whatever index pip is configured for
    installed = subprocess.run(
        [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-compile", ".", "./client"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert installed.returncode == 0, installed.stderr
    (packages,) = venv.glob("lib/python*/site-packages")
    there = {canonicalize_name(each.metadata["Name"]): each for each in distributions(path=[str(packages)])}
    assert there.keys() == {*_closure(("numpy", "httpx", "protobuf"), there), "slamcu-core", "slamcu-client"}
    code = "import slamcu_client, importlib.util; print(importlib.util.find_spec('slamcu_server'))"
    asked = subprocess.run([python, "-I", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert asked.stdout == "None\n"
    command = venv / "bin" / "slamcu-vehicle"
    version = subprocess.run([command, "--version"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert version.stdout.startswith("slamcu-client/")
