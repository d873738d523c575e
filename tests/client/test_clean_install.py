from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

_WHAT_IS_THERE = """
import importlib.util, json, re
from importlib.metadata import distribution, distributions
from pip._vendor.packaging.requirements import Requirement

def canonical(name):
    return re.sub(r"[-_.]+", "-", name).lower()

def needs(name, seen):
    if name not in seen:
        seen.add(name)
        for line in distribution(name).requires or ():
            requirement = Requirement(line)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                needs(canonical(requirement.name), seen)
    return seen

allowed = set()
for name in ("numpy", "httpx", "protobuf"):
    needs(name, allowed)
print(json.dumps({
    "installed": sorted({canonical(one.metadata["Name"]) for one in distributions()} - {"pip", "setuptools"}),
    "allowed": sorted(allowed),
    "server": importlib.util.find_spec("slamcu_server") is not None,
}))
"""


@pytest.mark.slow
def test_a_clean_environment_gets_the_client_and_nothing_of_the_server(tmp_path: Path) -> None:
    """What the README tells a vehicle developer to type, in an environment that has nothing."""
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    python = tmp_path / "venv" / "bin" / "python"
    # from the root of the tree, as a reader types it, with whatever index pip is configured for
    installed = subprocess.run(
        [python, "-m", "pip", "install", "--quiet", ".", "./client"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert installed.returncode == 0, installed.stderr
    asked = subprocess.run(
        [python, "-I", "-c", _WHAT_IS_THERE], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    there = json.loads(asked.stdout)
    assert set(there["installed"]) == {*there["allowed"], "slamcu-core", "slamcu-client"}
    assert not there["server"]
    command = tmp_path / "venv" / "bin" / "slamcu-vehicle"
    version = subprocess.run([command, "--version"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert version.stdout.startswith("slamcu-client/")
