"""A real PostGIS for every test of the server: one private cluster a session, one fresh database a test."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import uuid4

import asyncpg
import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.formats import write_hd_map
from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_core.reports import DetectionStatus, MapReference, PassReport, ReportMessage
from slamcu_server import cli
from slamcu_server.accounts.schemas import ALL_MAPS, IssuedKey, MapScope, Role
from slamcu_server.accounts.service import create_account
from slamcu_server.app import create_app
from slamcu_server.database import migrate
from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.engine import create_engine
from slamcu_server.maps.importer import import_map
from slamcu_server.settings import Settings

_TEMPLATE = "slamcu_template"
_COMMAND = (sys.executable, "-m", "slamcu_server")
_CONFIGURATION = (
    ("fsync", "off"),  # no test cuts the power
    ("max_wal_size", "'256MB'"),  # of memory
    ("shared_preload_libraries", "'postgis-3'"),  # else each of the many connections loads it anew
)
IssueKey = Callable[..., Awaitable[IssuedKey]]
MakeReport = Callable[..., ReportMessage]


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="session")
def short_dir() -> Iterator[Path]:
    """A directory whose path is short enough for sockets and which other users may be let into."""
    directory = Path(tempfile.mkdtemp(prefix="slamcu-test-"))
    directory.chmod(0o711)
    yield directory
    shutil.rmtree(directory)


@pytest.fixture(scope="session")
def cluster(short_dir: Path) -> Iterator[EmbeddedCluster]:
    with EmbeddedCluster(short_dir / "session") as running:
        asyncio.run(_administer(running, *(f"ALTER SYSTEM SET {name} = {value}" for name, value in _CONFIGURATION)))
    with EmbeddedCluster(short_dir / "session") as running:
        yield running


async def _administer(cluster: EmbeddedCluster, *statements: str) -> None:
    connection = await asyncpg.connect(cluster.url_of("postgres").replace("+asyncpg", ""))
    try:
        for statement in statements:
            await connection.execute(statement)
    finally:
        await connection.close()


@pytest.fixture(scope="session")
def template(cluster: EmbeddedCluster) -> str:
    """A database made by running the migrations, and how it is copied: "TEMPLATE …"."""

    async def make() -> int:
        await _administer(cluster, f"CREATE DATABASE {_TEMPLATE}")
        engine = create_engine(cluster.url_of(_TEMPLATE))
        await migrate.upgrade(engine)
        async with engine.connect() as connection:
            version = await connection.scalar(text("SELECT current_setting('server_version_num')::int"))
        await engine.dispose()
        return int(version)

    by_files = asyncio.run(make()) >= 15_00_00  # which an older one does without being told
    return f"TEMPLATE {_TEMPLATE} STRATEGY file_copy" if by_files else f"TEMPLATE {_TEMPLATE}"


@pytest.fixture
def database_url(cluster: EmbeddedCluster, template: str) -> Iterator[str]:
    """The SQLAlchemy URL of an empty database of the newest schema."""
    name = f"test_{uuid4().hex}"
    asyncio.run(_administer(cluster, f"CREATE DATABASE {name} {template}"))
    yield cluster.url_of(name)
    asyncio.run(_administer(cluster, f"DROP DATABASE {name} WITH (FORCE)"))


@pytest.fixture
async def engine(database_url: str) -> AsyncIterator[AsyncEngine]:
    engine = create_engine(database_url, application_name="slamcu-test")
    yield engine
    await engine.dispose()


@pytest.fixture
def settings(database_url: str) -> Settings:
    """Settings on the test's database, without a worker: tests call what they want aggregated."""
    return Settings(database_url=database_url, embedded_worker=False)


@pytest.fixture
async def app(settings: Settings, engine: AsyncEngine) -> AsyncIterator[FastAPI]:
    app = create_app(settings, engine=engine)
    async with app.router.lifespan_context(app):
        yield app


@pytest.fixture
async def client(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    """A client of the application without a key; pass `headers=auth(key)`."""
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://slamcu.test") as client:
        yield client


@pytest.fixture
def issue_key(engine: AsyncEngine) -> IssueKey:
    """`await issue_key("vehicle", label=None, maps=("town",))`: a new account, bound to maps if given, and its key."""

    async def issue(role: str, label: str | None = None, maps: Iterable[str] | None = None) -> IssuedKey:
        scope = ALL_MAPS if maps is None else MapScope(frozenset(maps))
        async with engine.begin() as connection:
            return await create_account(connection, Role(role), label, scope)

    return issue


@pytest.fixture
async def vehicle(issue_key: IssueKey) -> dict[str, str]:
    """The headers of a vehicle."""
    return _auth(await issue_key("vehicle", "vehicle"))


@pytest.fixture
async def provider(issue_key: IssueKey) -> dict[str, str]:
    """The headers of a map provider."""
    return _auth(await issue_key("provider", "provider"))


@pytest.fixture
async def admin(issue_key: IssueKey) -> dict[str, str]:
    """The headers of an admin."""
    return _auth(await issue_key("admin", "admin"))


@pytest.fixture
def auth() -> Callable[[IssuedKey], dict[str, str]]:
    """`auth(key)`: the headers of the key's holder."""
    return _auth


def _auth(key: IssuedKey) -> dict[str, str]:
    return {"Authorization": f"Bearer {key.key}"}


@dataclass
class ServerProcess:
    """A real `slamcu-server` process on a real port."""

    environment: dict[str, str]
    directory: Path
    arguments: tuple[str, ...] = ()
    url: str = ""
    process: subprocess.Popen[bytes] | None = None
    log: Path = field(init=False)

    def __post_init__(self) -> None:
        self.log = self.directory / "server.log"

    def start(self) -> None:
        ready = self.directory / "ready"
        ready.unlink(missing_ok=True)
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [*_COMMAND, "serve", "--port", "0", "--ready-file", str(ready), *self.arguments],
                env=self.environment,
                stdout=log,
                stderr=log,
            )
        deadline = time.monotonic() + 60
        while not ready.exists():
            assert self.process.poll() is None, self.log.read_text()
            assert time.monotonic() < deadline, self.log.read_text()
            time.sleep(0.02)
        self.url = ready.read_text().strip()

    def kill(self) -> None:
        """End the process as a power cut would."""
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        """Ask the process to end, and return its exit status."""
        assert self.process is not None
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout=30)


@pytest.fixture
def server_environment(database_url: str) -> dict[str, str]:
    """The environment of a command on the test's database."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("SLAMCU_", "PG"))}
    return clean | {"SLAMCU_DATABASE_URL": database_url}


@pytest.fixture
def command(
    server_environment: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., subprocess.CompletedProcess[str]]:
    """`command("list-keys")`: run slamcu-server on the test's database, in this process, and return what it said."""

    def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        with monkeypatch.context() as patch:
            for name, value in (server_environment | environment).items():
                patch.setenv(name, value)
            patch.setattr(sys, "argv", ["slamcu-server", *arguments])
            capsys.readouterr()
            with pytest.raises(SystemExit) as ended:
                cli.main()
            said = capsys.readouterr()
        return subprocess.CompletedProcess(arguments, int(ended.value.code or 0), said.out, said.err)

    return run


@pytest.fixture
def server_process(server_environment: dict[str, str], tmp_path: Path) -> Iterator[ServerProcess]:
    """A server on the test's database, not started yet; it may be killed and started again."""
    server = ServerProcess(server_environment, tmp_path)
    yield server
    if server.process is not None:
        server.stop()


@pytest.fixture
def live_server(server_process: ServerProcess) -> ServerProcess:
    """A server that listens; `live_server.url` is where."""
    server_process.start()
    return server_process


@pytest.fixture
async def town(engine: AsyncEngine, tmp_path: Path) -> MapIdentity:
    """The map "town" version "1": speed limit signs with the ids 1 to 5, every 100 m along a road to the east."""
    identity = MapIdentity("town", "1")
    features = [
        MapFeature(number, lon=2.1 + 0.00137 * number, lat=48.9, sign="SPEED_LIMIT", value="80")
        for number in range(1, 6)
    ]
    path = tmp_path / "town.geojson"
    path.write_text("".join(write_hd_map(identity, features)))
    async with engine.begin() as connection:
        await import_map(connection, path)
    return identity


@pytest.fixture
def make_report() -> MakeReport:
    """`make_report(message_id, …)`: a message of session "drive" about the town's sign 1; fields can be replaced."""

    def make(message_id: int = 1, **fields: Any) -> ReportMessage:
        begun = datetime(2026, 5, 1, 8, 0, message_id % 60, tzinfo=UTC)
        one = PassReport(
            started_at=begun,
            ended_at=begun + timedelta(seconds=2),
            status=DetectionStatus.EXPECTED_AND_DETECTED,
            weight_for=1.2,
            weight_against=0.1,
            sign="SPEED_LIMIT",
            value="80",
            reference=MapReference(tile_id=1, object_id=1),
            frames_detected=9,
            frames_missed=1,
        )
        message = ReportMessage("drive", message_id, (one,), map_identity=MapIdentity("town", "1"))
        return replace(message, **fields)

    return make
