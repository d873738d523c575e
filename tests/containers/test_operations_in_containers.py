"""The commands of docs/operations.md, in their order, against real containers; and how these are locked down."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from slamcu_eval.scenario.ports import free_port

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```bash\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TEXT = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")
PRELUDE = """
docker() {
  if [ "$1" = compose ] && ! command docker compose version >/dev/null 2>&1; then shift; docker-compose "$@"
  else command docker "$@"; fi
}
trap 'docker compose ps > ps.txt; docker compose logs --no-color > services.log 2>&1' EXIT
"""


@pytest.fixture
def project(tmp_path: Path) -> Iterator[tuple[Path, dict[str, str]]]:
    """A folder with what the commands need of the tree, and an environment; its containers are removed at the end."""
    for name in ("docker-compose.yml", "docker-compose.override.yml"):
        shutil.copy(ROOT / name, tmp_path)
    for name in ("containers", "build/wheelhouse"):
        shutil.copytree(ROOT / name, tmp_path / name)
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("SLAMCU_", "COMPOSE_"))}
    environment |= {
        "COMPOSE_PROJECT_NAME": f"slamcu-test-{os.getpid()}",
        "SLAMCU_PORT": str(free_port()),
        "SLAMCU_SECRETS": str(tmp_path / "secrets"),
    }
    subprocess.run([ROOT / "scripts" / "secrets"], env=environment, check=True)
    yield tmp_path, environment
    _bash("docker compose down --volumes --remove-orphans", tmp_path, environment)


def _bash(script: str, folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", PRELUDE + script],
        cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
    )  # fmt: skip


def _keep(folder: Path, name: str, done: subprocess.CompletedProcess[str]) -> None:
    logs = ROOT / "build" / "e2e"
    logs.mkdir(parents=True, exist_ok=True)
    (logs / f"{name}.txt").write_text(f"{done.stdout}\n--- errors\n{done.stderr}", encoding="utf-8")
    for file in folder.glob("*.log"):
        shutil.copy(file, logs / f"{name}-{file.name}")


@pytest.mark.timeout(1200)
def test_the_documented_commands_work_as_printed(project: tuple[Path, dict[str, str]]) -> None:
    folder, environment = project
    blocks = [block for block in BLOCK.findall(TEXT) if "slamcu-server " not in block]
    script = "".join(f"echo '::: {number}'\n{block}" for number, block in enumerate(blocks))
    script = script.replace("127.0.0.1:8000", f"127.0.0.1:{environment['SLAMCU_PORT']}")
    script = script.replace("make images", "true  # are built")
    done = _bash(script, folder, environment)
    _keep(folder, "operations", done)
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-3000:]}"
    assert json.loads((folder / "after.json").read_text()) == json.loads((folder / "before.json").read_text())

    containers = _inspect(environment)
    assert {name for name, one in containers.items() if one["State"]["Running"]} == {
        "database", "api-1", "api-2", "worker-1", "worker-2", "proxy",
    }  # fmt: skip
    for name, one in containers.items():
        host = one["HostConfig"]
        assert one["Config"]["User"] not in ("", "0", "root"), name
        assert host["ReadonlyRootfs"], name
        assert host["CapDrop"] == ["ALL"], name
        assert host["SecurityOpt"] == ["no-new-privileges:true"], name
        assert host["Memory"] > 0, name
        assert not host["Privileged"], name
        told = json.dumps(one["Config"]["Env"]) + json.dumps(one["Config"]["Cmd"])
        assert (folder / "secrets" / "database_password").read_text() not in told, name
        if name != "migrate":
            assert host["RestartPolicy"]["Name"] == "unless-stopped", name
            assert one["State"]["Health"]["Status"] == "healthy", name
    ports = {name: one["HostConfig"]["PortBindings"] for name, one in containers.items()}
    assert {name for name, bound in ports.items() if bound} == {"proxy"}
    assert ports["proxy"]["8000/tcp"][0]["HostIp"] == "127.0.0.1"


def _inspect(environment: dict[str, str]) -> dict[str, dict[str, Any]]:
    label = f"label=com.docker.compose.project={environment['COMPOSE_PROJECT_NAME']}"
    names = _docker("ps", "--all", "--quiet", "--filter", label).split()
    found = json.loads(_docker("inspect", *names))
    return {one["Config"]["Labels"]["com.docker.compose.service"]: one for one in found}


def _docker(*arguments: str) -> str:
    return subprocess.run(["docker", *arguments], check=True, capture_output=True, text=True).stdout


@pytest.mark.timeout(1200)
def test_docker_compose_up_shows_a_fleet_at_work(project: tuple[Path, dict[str, str]]) -> None:
    folder, environment = project
    up = "docker compose up -d --no-build\n"
    done = _bash(
        up + 'docker wait "$(docker compose ps --all --quiet verdict)"\ndocker compose logs --no-color verdict\n',
        folder,
        environment,
    )
    _keep(folder, "demonstration", done)
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-3000:]}"
    assert "7 changes accepted, and the fleet has nothing left to report" in done.stdout
    said = (ROOT / "build" / "e2e" / "demonstration-services.log").read_text(encoding="utf-8")
    assert "the cars have lost their network" in said
    assert "accepted 2 deleted, 1 modified, 1 moved, 3 new" in said


@pytest.mark.parametrize(
    ("image", "there", "absent"),
    [
        (
            "vehicle",
            {"slamcu_core", "slamcu_client", "numpy"},
            {"slamcu_server", "slamcu_eval", "sqlalchemy", "fastapi"},
        ),
        ("server", {"slamcu_core", "slamcu_server", "fastapi"}, {"slamcu_client", "slamcu_eval", "matplotlib"}),
    ],
)
def test_images_hold_what_they_need_and_nothing_else(image: str, there: set[str], absent: set[str]) -> None:
    code = "import json, pkgutil; print(json.dumps([m.name for m in pkgutil.iter_modules()]))"
    name = f"slamcu-{image}:{version('slamcu-server')}"
    modules = set(json.loads(_docker("run", "--rm", "--entrypoint", "/opt/slamcu/bin/python", name, "-c", code)))
    assert there <= modules
    assert not modules & (absent | {"pip", "pytest", "mypy", "hatchling", "setuptools"})
    tools = _docker("run", "--rm", "--entrypoint", "/bin/sh", name, "-c", "command -v gcc make git curl pip || true")
    assert not tools.strip()
    tests = _docker("run", "--rm", "--entrypoint", "/bin/sh", name, "-c", "find /opt/slamcu -type d -name tests")
    assert not tests.strip()
    labels = json.loads(_docker("inspect", name))[0]["Config"]["Labels"]
    assert labels["org.opencontainers.image.licenses"] == "Apache-2.0"
    assert labels["org.opencontainers.image.version"] == version("slamcu-server")
