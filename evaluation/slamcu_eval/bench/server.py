"""A private cluster for the bench, and a real server on one of its databases that serves and does not aggregate."""

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
from slamcu_eval.bench.cloud import migrated
from slamcu_eval.bench.traffic import MAP, road
from slamcu_server.database.embedded import EmbeddedCluster

_START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 20.0
_COMMAND = (sys.executable, "-m", "slamcu_server")


@dataclass(frozen=True, slots=True)
class BenchServer:
    """Where the server and its database are, the keys of its vehicles and of a provider, and the size of its map."""

    url: str
    database_url: str  # SQLAlchemy's
    keys: tuple[str, ...]
    provider: str
    features: int
    pid: int


@contextmanager
def bench_cluster() -> Iterator[EmbeddedCluster]:
    """Run an empty private cluster, and leave nothing behind."""
    with tempfile.TemporaryDirectory(prefix="slamcu-bench-", ignore_cleanup_errors=True) as name:
        home = Path(name)
        home.chmod(0o711)  # PostgreSQL does not run as root, and must be able to get to its directory
        with EmbeddedCluster(home / "data") as cluster:
            yield cluster


@contextmanager
def bench_server(database_url: str, vehicles: int, features: int = 0) -> Iterator[BenchServer]:
    """Run a server without a worker on a database, with a new map of some features (none: it has one already).

    Raises SlamcuError if the server does not come up.
    """
    asyncio.run(migrated(database_url))
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SLAMCU_")}
    environment |= {"SLAMCU_DATABASE_URL": database_url, "SLAMCU_LOG_LEVEL": "warning"}
    environment |= {"SLAMCU_PASSES_PER_S": "0"}  # a few vehicles stand for many
    with tempfile.TemporaryDirectory(prefix="slamcu-bench-") as name:
        home = Path(name)
        if features:
            map_file = home / "map.geojson"
            map_file.write_text("".join(write_hd_map(MAP, road(features))), encoding="utf-8")
            _run(environment, "import-map", str(map_file))
        keys = [_keys(environment, "vehicle", vehicles), _keys(environment, "provider", 1)]
        with _serving(environment, home) as (url, pid):
            yield BenchServer(url, database_url, keys[0], keys[1][0], features, pid)


def _keys(environment: dict[str, str], role: str, count: int) -> tuple[str, ...]:
    listed = _run(environment, "create-key", "--role", role, "--label", f"bench {role}", "--count", str(count))
    return tuple(line.rsplit("\t", 1)[-1] for line in listed.split("\n") if line)


def _run(environment: dict[str, str], *arguments: str) -> str:
    done = subprocess.run(  # noqa: S603  (our own program)
        [*_COMMAND, *arguments], env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise SlamcuError(f"slamcu-server {arguments[0]} failed: {done.stderr.strip()}")
    return done.stdout


@contextmanager
def _serving(environment: dict[str, str], home: Path) -> Iterator[tuple[str, int]]:
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
        yield ready.read_text(encoding="utf-8").strip(), process.pid
    finally:
        process.terminate()
        try:
            process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
