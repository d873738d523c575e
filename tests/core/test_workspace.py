"""The lock and the four distributions fit together, and a car installs no more than it needs."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[2]
LOCK = (ROOT / "requirements.lock").read_text()
PROJECTS = {
    "slamcu-core": ROOT / "pyproject.toml",
    "slamcu-client": ROOT / "client" / "pyproject.toml",
    "slamcu-server": ROOT / "server" / "pyproject.toml",
    "slamcu-eval": ROOT / "evaluation" / "pyproject.toml",
}


def _project(path: Path) -> dict:
    return tomllib.loads(path.read_text())


def _entries() -> Iterator[tuple[Requirement, list[str]]]:
    """Yield each locked requirement with its hashes."""
    text = re.sub(r"\\\n", " ", LOCK)
    for line in text.splitlines():
        if line.strip() and not line.startswith("#"):
            requirement, *hashes = re.split(r"\s+--hash=", line.strip())
            yield Requirement(requirement), hashes


def _applies(requirement: Requirement, **environment: str) -> bool:
    return requirement.marker is None or requirement.marker.evaluate(
        {**default_environment(), "extra": ""} | environment
    )


def _declared() -> list[Requirement]:
    development = _project(PROJECTS["slamcu-core"])["dependency-groups"]["dev"]
    shipped = [entry for path in PROJECTS.values() for entry in _project(path)["project"]["dependencies"]]
    return [Requirement(entry) for entry in [*shipped, *development] if not entry.startswith("slamcu-")]


def _closure(roots: list[str]) -> set[str]:
    """Return the names of all that the installed distributions `roots` bring along, themselves included."""
    found: set[str] = set()
    waiting = [Requirement(root) for root in roots]
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        extras = requirement.extras or {""}
        if name in found and not requirement.extras:
            continue
        found.add(name)
        needed = [Requirement(entry) for entry in metadata.requires(name) or []]
        waiting += [entry for entry in needed if any(_applies(entry, extra=extra) for extra in extras)]
    return found


def test_every_locked_package_is_pinned_to_one_version_with_hashes() -> None:
    entries = list(_entries())
    assert len(entries) > 50
    for requirement, hashes in entries:
        specifiers = list(requirement.specifier)
        assert [specifier.operator for specifier in specifiers] == ["=="], requirement
        assert "*" not in specifiers[0].version, requirement
        assert hashes, requirement
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", value) for value in hashes), requirement


def test_the_lock_names_no_place_to_download_from() -> None:
    assert "://" not in LOCK
    options = {option for line in LOCK.splitlines() for option in re.findall(r"(?:^|\s)(--?[A-Za-z][\w-]*)", line)}
    assert options == {"--hash"}
    assert not any(requirement.url for requirement, _ in _entries())


@pytest.mark.parametrize("python_version", ["3.11", "3.12", "3.13"])
@pytest.mark.parametrize("platform", ["linux", "darwin"])
def test_the_lock_satisfies_what_the_distributions_declare(python_version: str, platform: str) -> None:
    environment = {
        "python_version": python_version,
        "python_full_version": f"{python_version}.0",
        "sys_platform": platform,
    }
    locked = {
        canonicalize_name(requirement.name): Version(next(iter(requirement.specifier)).version)
        for requirement, _ in _entries()
        if _applies(requirement, **environment)
    }
    for requirement in _declared():
        if _applies(requirement, **environment):
            name = canonicalize_name(requirement.name)
            assert name in locked, f"{requirement} is not in requirements.lock: run make lock"
            assert requirement.specifier.contains(locked[name], prereleases=True), (
                f"{requirement} against {locked[name]}"
            )


def test_the_lock_holds_all_that_the_distributions_bring_along() -> None:
    locked = {canonicalize_name(requirement.name) for requirement, _ in _entries()}
    assert _closure(list(PROJECTS)) - set(PROJECTS) <= locked


def test_the_environment_is_the_locked_one() -> None:
    for requirement, _ in _entries():
        if _applies(requirement):
            assert requirement.specifier.contains(metadata.version(requirement.name), prereleases=True), requirement


def test_the_four_distributions_go_together_by_version() -> None:
    versions = {name: _project(path)["project"]["version"] for name, path in PROJECTS.items()}
    assert len(set(versions.values())) == 1, versions
    for path in PROJECTS.values():
        for entry in _project(path)["project"]["dependencies"]:
            if entry.startswith("slamcu-"):
                requirement = Requirement(entry)
                assert requirement.specifier == Requirement(f"x=={versions[requirement.name]}").specifier


def test_a_car_installs_no_server_and_nothing_but_numpy_httpx_and_protobuf() -> None:
    brought = _closure(["slamcu-client"])
    needed = _closure(["numpy", "httpx", "protobuf"])
    assert brought == needed | {"slamcu-core", "slamcu-client"}
    assert not brought & {"slamcu-server", "fastapi", "sqlalchemy", "pydantic", "uvicorn"}


@pytest.mark.parametrize("name", PROJECTS)
def test_a_source_archive_is_whole(name: str, tmp_path: Path) -> None:
    """The wheel that is built from it, as packagers do, holds the code, the licence and what it needs beside them."""
    _build(PROJECTS[name].parent, "sdist", tmp_path)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as source:
        source.extractall(tmp_path, filter="data")
    _build(tmp_path / archive.name.removesuffix(".tar.gz"), "wheel", tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as built:
        files = {path.split("/", 1)[-1]: built.read(path) for path in built.namelist()}
    assert files["licenses/LICENSE"] == (ROOT / "LICENSE").read_bytes()
    assert b"\nDescription-Content-Type: text/markdown" in files["METADATA"]
    assert "py.typed" in files
    assert ("slamcu_vehicle.py" in files) == (name == "slamcu-client")
    assert ("migrations/env.py" in files) == (name == "slamcu-server")


def _build(project: Path, target: str, into: Path) -> None:
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", target, "-d", into], cwd=project, check=True)
