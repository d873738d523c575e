"""A real server for the bench: its own cluster, the bench's map, a process that serves and nothing that aggregates."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from slamcu_core.errors import SlamcuError
from slamcu_core.formats import write_hd_map
from slamcu_eval.bench.traffic import MAP, road
from slamcu_server.database import migrate
from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.engine import create_engine

_START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 20.0
_COMMAND = (sys.executable, "-m", "slamcu_server.cli")


@dataclass(frozen=True, slots=True)
class BenchServer:
    """Where the server and its database are, and the keys of its vehicles."""

    url: str
    database_url: str  # SQLAlchemy's
    keys: tuple[str, ...]


@contextmanager
def bench_server(vehicles: int) -> Iterator[BenchServer]:
    """Run a server without a worker on an empty private cluster, and leave nothing behind.

    Raises SlamcuError if the server does not come up.
    """
    with tempfile.TemporaryDirectory(prefix="slamcu-bench-", ignore_cleanup_errors=True) as name:
        home = Path(name)
        home.chmod(0o711)  # PostgreSQL does not run as root, and must be able to get to its directory
        with EmbeddedCluster(home / "data") as cluster:
            asyncio.run(_migrate(cluster.url))
            environment = {name: value for name, value in os.environ.items() if not name.startswith("SLAMCU_")}
            environment |= {"SLAMCU_DATABASE_URL": cluster.url, "SLAMCU_LOG_LEVEL": "warning"}
            map_file = home / "map.geojson"
            map_file.write_text("".join(write_hd_map(MAP, road())), encoding="utf-8")
            _run(environment, "import-map", str(map_file))
            listed = _run(environment, "create-key", "--role", "vehicle", "--label", "bench", "--count", str(vehicles))
            keys = tuple(line.rsplit("\t", 1)[-1] for line in listed.split("\n") if line)
            with _serving(environment, home) as url:
                yield BenchServer(url, cluster.url, keys)


async def _migrate(url: str) -> None:
    engine = create_engine(url)
    try:
        await migrate.upgrade(engine)
    finally:
        await engine.dispose()


def _run(environment: dict[str, str], *arguments: str) -> str:
    done = subprocess.run(  # noqa: S603  (our own program)
        [*_COMMAND, *arguments], env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise SlamcuError(f"slamcu-server {arguments[0]} failed: {done.stderr.strip()}")
    return done.stdout


@contextmanager
def _serving(environment: dict[str, str], home: Path) -> Iterator[str]:
    ready = home / "ready"
    log = home / "server.log"
    with log.open("wb") as sink:
        process = subprocess.Popen(  # noqa: S603  (our own program)
            [*_COMMAND, "serve", "--no-worker", "--port", "0", "--ready-file", str(ready)],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=sink,
            stderr=sink,
        )
    try:
        deadline = time.monotonic() + _START_TIMEOUT_S
        while not ready.exists():
            if process.poll() is not None or time.monotonic() > deadline:
                raise SlamcuError(f"the server did not start: {log.read_text(errors='replace').strip()}")
            time.sleep(0.02)
        yield ready.read_text(encoding="utf-8").strip()
    finally:
        process.terminate()
        try:
            process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
