"""The rules of the code base that a reader relies on, checked on the code itself."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("slamcu_core", "client/slamcu_client", "server/slamcu_server", "evaluation/slamcu_eval")
LONGEST_MODULE = 400  # lines; beyond that a module says more than one thing

# Written in parts, so that this file does not hold what it forbids.
MACHINE_PATH = re.compile(r"(?<![\w.~*-])/(?:" + "|".join(("work", "root", "home")) + r")/[\w.-]")
# Where packages come from is the user's business: no file points an installer at an index of its own. A folder that an
# image brings along is none.
REGISTRY = re.compile(
    "|".join(("--(?:extra-)?index" + "-url", "--find" + "-links(?! /wheels )", r"https?://[\w.-]+/simple" + r"\b"))
)


def _modules(*packages: str) -> Iterator[Path]:
    """Yield the hand-written modules of the packages."""
    for package in packages:
        yield from (path for path in sorted((ROOT / package).rglob("*.py")) if not path.name.endswith("_pb2.py"))


def _imports(path: Path) -> Iterator[str]:
    """Yield the absolute modules that a file imports, wherever in the file it does so."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module


def _tracked() -> list[Path]:
    """Return the files that git keeps, whoever owns the clone."""
    listing = subprocess.run(
        ["git", "-c", "safe.directory=*", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    return [path for name in listing.split("\0") if name and (path := ROOT / name).is_file()]


def test_imports_keep_to_the_layers() -> None:
    result = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache"],
        check=False,
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert " 0 broken" in result.stdout


def test_the_core_needs_only_numpy_and_protobuf() -> None:
    foreign = {
        module
        for path in (ROOT / "slamcu_core").rglob("*.py")
        for module in _imports(path)
        if module.split(".")[0] not in sys.stdlib_module_names | {"slamcu_core"}
    }
    assert {module.split(".")[0] for module in foreign} <= {"numpy", "google"}
    assert all(module.startswith("google.protobuf") for module in foreign if module.startswith("google"))


def test_the_core_reads_no_clock_and_no_global_randomness() -> None:
    forbidden = re.compile(
        r"\b(?:time\.(?:time|monotonic|perf_counter)\(|datetime\.(?:now|utcnow)\(|np\.random\.(?!Generator\b))"
    )
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in _modules("slamcu_core")
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if forbidden.search(line)
    ]
    assert not found
    for path in _modules("slamcu_core"):
        banned = {"random", "time", "socket"}
        if path.stem != "program":  # which answers signals, as the main thread alone may
            banned.add("threading")
        assert not banned & set(_imports(path)), path


@pytest.mark.parametrize("package", PACKAGES)
def test_modules_are_short_enough_to_say_one_thing(package: str) -> None:
    modules = {path.relative_to(ROOT).as_posix(): len(path.read_text().splitlines()) for path in _modules(package)}
    assert modules
    assert not {name: lines for name, lines in modules.items() if lines > LONGEST_MODULE}


def test_no_tracked_file_names_a_registry_or_somebodys_machine() -> None:
    found = []
    for path in _tracked():
        try:
            lines = path.read_text().splitlines()
        except UnicodeDecodeError:
            continue  # pictures and other binary files hold no addresses that a person wrote
        found += [
            f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
            for number, line in enumerate(lines, 1)
            if MACHINE_PATH.search(line) or REGISTRY.search(line)
        ]
    assert not found
