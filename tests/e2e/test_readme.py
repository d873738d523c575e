"""The README's tour works as it stands: its blocks are run in order against a real server."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from slamcu_client import VehicleSession
from slamcu_eval.highway import simulate
from slamcu_eval.scenario.ports import free_port

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
TOUR = re.compile(r"^## Five-minute tour$.*?(?=^## )", re.MULTILINE | re.DOTALL)
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(((?!https?://)[^)#]+)")


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder like a clone after `make setup`, short of the sources."""
    path = Path(tempfile.mkdtemp(prefix="slamcu-readme-"))
    (path / ".venv" / "bin").mkdir(parents=True)
    activate = f'export PATH={shlex.quote(str(Path(sys.executable).parent))}:"$PATH"\n'
    (path / ".venv" / "bin" / "activate").write_text(activate, encoding="utf-8")
    yield path
    shutil.rmtree(path)


def _script(tour: str, first_line: int, port: int) -> str:
    """Make one bash script of the blocks, the Python ones as children of the same shell; only the port differs."""
    # Whatever fails, the server is asked to end: it stops its database.
    parts = ["set -euo pipefail", "trap 'status=$?; jobs -p | xargs -r kill; wait; exit $status' EXIT"]
    for block in BLOCK.finditer(tour):
        language, code = block.groups()
        parts.append(f"echo '::: line {first_line + tour.count(chr(10), 0, block.start())}' | tee /dev/stderr")
        parts.append(code if language == "bash" else f"python - <<'END_OF_PYTHON'\n{code}END_OF_PYTHON\n")
    return re.sub(r"\b8000\b", str(port), "\n".join(parts))


@pytest.mark.slow
def test_the_tour_runs_as_printed(folder: Path) -> None:
    tour = TOUR.search(README)
    assert tour is not None
    script = _script(tour.group(), README.count("\n", 0, tour.start()) + 1, free_port())
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("SLAMCU_", "PYTHON"))}
    process = subprocess.Popen(
        ["bash", "-c", script],
        cwd=folder,
        env=environment | {"LC_ALL": "C.UTF-8"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        output, errors = process.communicate(timeout=240)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGTERM)
        output, errors = process.communicate()
    assert process.returncode == 0, f"{output[-3000:]}\n{errors[-3000:]}"
    assert output.count("0 rejected, 0 waiting") == 6, "every car's reports were taken"
    assert '"decision":"accept"' in output, "the change was accepted"
    maps = json.loads(next(line for line in output.split("\n") if line.startswith('{"maps"')))
    assert [(one["source"], one["sequence"], one["features"]) for one in maps["maps"]] == [("highway-7", 2, 9)]
    assert re.search(r"^17 deleted 0\.9", output, re.MULTILINE), "one car alone sees that the sign is gone"
    assert re.search(r"^\d+ \d+ deleted confirmed$", output, re.MULTILINE), "a follower of the feed is told so"
    assert re.search(
        r"passes reported; UploadResult\(accepted=[1-9]\d*, duplicates=0, rejected=0, remaining=0\)", output
    )
    assert not (folder / "tour").exists()


def test_the_tour_has_both_audiences() -> None:
    tour = TOUR.search(README)
    assert tour is not None
    languages = [block.group(1) for block in BLOCK.finditer(tour.group())]
    assert languages.count("python") >= 2
    assert languages.count("bash") >= 3


def test_the_first_commands_are_the_two_that_matter() -> None:
    block = BLOCK.search(README)
    assert block is not None
    commands = [line.split("#")[0].strip() for line in block.group(2).strip().split("\n")]
    assert commands == ["make demo", "make test"]
    assert "make test" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


@pytest.mark.parametrize("document", ["README.md", "docs/client.md"])
def test_printed_python_holds_for_whatever_a_drive_brings(document: str, tmp_path: Path) -> None:
    """A recorded drive has finds, which no map feature belongs to: types know that, one run of the tour may not."""
    text = (ROOT / document).read_text(encoding="utf-8")
    blocks = [code for language, code in BLOCK.findall(text) if language == "python"]
    assert blocks
    for number, code in enumerate(blocks):
        (tmp_path / f"block_{number}.py").write_text(code, encoding="utf-8")
    mypy = ["mypy", "--strict", *map(str, sorted(tmp_path.glob("*.py")))]
    ruff = ["ruff", "check", "--isolated", "--select", "E,F,B,UP", "--line-length", "120", str(tmp_path)]
    for tool in (mypy, ruff):
        done = subprocess.run([sys.executable, "-m", *tool], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


def test_the_first_example_prints_a_drive_with_finds_too(capsys: pytest.CaptureFixture[str]) -> None:
    code = next(code for _, code in BLOCK.findall(README) if "session.features()" in code)
    world, drives = simulate(7, length_m=2000.0, normal=8, deleted=2, new=3)
    with VehicleSession(world.hd_map, drives[0].header) as session:
        for record in drives[0].records:
            session.feed(record)
    exec(code[code.index("for one in session.features()") :], {"session": session})
    told = capsys.readouterr().out.splitlines()
    assert len(told) == len(session.features())
    assert any(line.startswith("found here new") for line in told)


@pytest.mark.parametrize(
    "document",
    ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", *(f"docs/{path.name}" for path in sorted(ROOT.glob("docs/*.md")))],
)
def test_links_lead_somewhere(document: str) -> None:
    path = ROOT / document
    broken = [link for link in LINK.findall(path.read_text(encoding="utf-8")) if not (path.parent / link).exists()]
    assert not broken
