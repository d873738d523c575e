"""What is built from this tree: complete without the tree, and without the server in a car."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[2]
SITE_PACKAGES = sysconfig.get_path("purelib")


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Build the wheels and return them by the name of their distribution."""
    target = tmp_path_factory.mktemp("wheels")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    sources = [ROOT, ROOT / "client", ROOT / "server", ROOT / "evaluation"]
    subprocess.run([*command, "--wheel-dir", target, *sources], check=True, capture_output=True, text=True)
    return {path.name.split("-")[0]: path for path in target.glob("*.whl")}


def _unpack(target: Path, *wheels: Path) -> Path:
    for wheel in wheels:
        with ZipFile(wheel) as archive:
            archive.extractall(target)
    return target


def _python(code: str, installed: Path) -> str:
    """Run code where only the unpacked wheels and the third-party packages can be imported."""
    prelude = f"import sys; sys.path[:0] = [{str(installed)!r}, {SITE_PACKAGES!r}]\n"  # no site: no editable installs
    result = subprocess.run(
        [sys.executable, "-I", "-S", "-c", prelude + code], check=False, capture_output=True, text=True, cwd=installed
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_a_car_gets_the_whole_client_and_no_server(wheels: dict[str, Path], tmp_path: Path) -> None:
    installed = _unpack(tmp_path, wheels["slamcu_core"], wheels["slamcu_client"])
    packages = {path.name for path in installed.iterdir() if path.is_dir() and not path.name.endswith(".dist-info")}
    assert packages == {"slamcu_core", "slamcu_client"}
    code = """
import importlib, pkgutil, slamcu_core, slamcu_client, slamcu_vehicle
for package in (slamcu_core, slamcu_client):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
print(sorted({"fastapi", "sqlalchemy", "pydantic", "matplotlib", "slamcu_server"} & set(sys.modules)))
"""
    assert _python(code, installed).strip() == "[]"


def test_the_server_carries_its_migrations(wheels: dict[str, Path], tmp_path: Path) -> None:
    installed = _unpack(tmp_path, wheels["slamcu_core"], wheels["slamcu_server"])
    shipped = {path.name for path in (installed / "slamcu_server" / "migrations").rglob("*.py")}
    assert {path.name for path in (ROOT / "migrations").rglob("*.py")} == shipped
    assert _python("import slamcu_server.cli; print(slamcu_server.__file__)", installed).startswith(str(installed))


@pytest.mark.parametrize("distribution", ["slamcu_core", "slamcu_client", "slamcu_server", "slamcu_eval"])
def test_every_package_ships_its_types_and_no_tests(wheels: dict[str, Path], distribution: str) -> None:
    names = ZipFile(wheels[distribution]).namelist()
    assert f"{distribution}/py.typed" in names
    assert not [name for name in names if "test" in name.split("/")[0] or name.endswith(".pyc")]


def test_each_wheel_carries_the_licence(wheels: dict[str, Path]) -> None:
    names = ZipFile(wheels["slamcu_core"]).namelist()
    assert any(name.endswith("LICENSE") for name in names)
