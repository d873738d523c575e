"""The commands of docs/operations.md that need no containers work as printed; `make e2e` runs the others."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import pytest

from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.postgres_tools import PostgresTools, RunAs

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```bash\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TEXT = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")


def _without_containers() -> list[str]:
    return [block for block in BLOCK.findall(TEXT) if "slamcu-server " in block]


@pytest.mark.slow
def test_the_commands_without_containers_run_as_printed() -> None:
    blocks = _without_containers()
    assert blocks
    with tempfile.TemporaryDirectory(prefix="slamcu-operations-") as folder, EmbeddedCluster(Path(folder)) as cluster:
        home = Path(folder)
        tools = PostgresTools.find(RunAs.current())
        clean = {name: value for name, value in os.environ.items() if not name.startswith("SLAMCU_")}
        environment = clean | {
            "SLAMCU_DATABASE_URL": cluster.url.replace("+asyncpg", ""),
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), str(tools.bin_dir), os.environ["PATH"]]),
        }
        done = subprocess.run(
            ["bash", "-euxo", "pipefail", "-c", "slamcu-server migrate\n" + "".join(blocks)],
            cwd=home, env=environment, check=False, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr[-3000:]
        assert (home / "slamcu.dump").stat().st_size > 1000


def test_every_service_and_limit_is_told() -> None:
    compose = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    services = re.findall(
        r"^  ([a-z0-9-]+):$", compose[compose.index("services:") : compose.index("\nnetworks:")], re.M
    )
    table = set(re.findall(r"`([a-z0-9-]+)`", TEXT[: TEXT.index("Nothing runs as root")]))
    assert set(services) <= table


def test_the_images_are_of_this_version() -> None:
    named = set()
    for name in ("docker-compose.yml", "docker-compose.override.yml"):
        named |= set(re.findall(r"SLAMCU_VERSION:-([^}]+)}", (ROOT / name).read_text(encoding="utf-8")))
    assert named == {version("slamcu-server")}
