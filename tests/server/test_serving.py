"""Real processes: they start, tell where they listen, survive kill -9 without losing a message, and stop cleanly."""

from __future__ import annotations

import asyncio
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import closing, contextmanager
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.formats import write_hd_map
from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import encode_batch, serialize_message
from slamcu_server.accounts.schemas import IssuedKey, Role
from slamcu_server.accounts.service import create_account
from slamcu_server.database.engine import create_engine
from slamcu_server.maps.importer import import_map

T = Callable[[AsyncEngine], Awaitable[Any]]
MakeReport = Callable[..., ReportMessage]
COMMAND = (sys.executable, "-m", "slamcu_server")
PROTOBUF = {"Content-Type": "application/x-protobuf"}


def on(url: str, work: T) -> Any:
    """Do asynchronous work on a database from a test that is not asynchronous."""

    async def run() -> Any:
        engine = create_engine(url)
        try:
            return await work(engine)
        finally:
            await engine.dispose()

    return asyncio.run(run())


@pytest.fixture
def vehicle_headers(database_url: str, tmp_path: Path) -> dict[str, str]:
    """The key of a vehicle, on a database with the map "town"."""
    path = tmp_path / "town.geojson"
    path.write_text("".join(write_hd_map(MapIdentity("town", "1"), [MapFeature(1, 2.1, 48.9, sign="SPEED_LIMIT")])))

    async def prepare(engine: AsyncEngine) -> IssuedKey:
        async with engine.begin() as connection:
            await import_map(connection, path)
            return await create_account(connection, Role.VEHICLE, "van")

    key: IssuedKey = on(database_url, prepare)
    return {"Authorization": f"Bearer {key.key}"}


async def logged(engine: AsyncEngine) -> list[tuple[str, int, bytes]]:
    async with engine.connect() as connection:
        rows = await connection.execute(text("SELECT session_id, message_id, body FROM messages"))
        return [(row.session_id, row.message_id, bytes(row.body)) for row in rows]


def test_a_car_that_loses_its_network_in_the_middle_of_an_upload_is_no_error_of_the_server(
    live_server: Any, vehicle_headers: dict[str, str]
) -> None:
    address = httpx.URL(live_server.url)
    head = f"POST /v1/data-messages HTTP/1.1\r\nHost: x\r\nAuthorization: {vehicle_headers['Authorization']}\r\n"
    head += "Content-Type: application/x-protobuf\r\nContent-Length: 1000\r\n\r\n"
    with socket.create_connection((address.host, address.port)) as car:
        car.sendall(head.encode() + b"the first bytes")
        time.sleep(0.3)
    wanted = 'slamcu_http_requests_total{method="POST",route="/v1/data-messages",status="499"} 1.0'
    deadline = time.monotonic() + 20
    while wanted not in (metrics := httpx.get(f"{live_server.url}/metrics").text):
        assert time.monotonic() < deadline, metrics
        time.sleep(0.05)
    assert 'status="500"' not in metrics
    assert live_server.stop() == 0
    log = live_server.log.read_text()
    assert "POST /v1/data-messages 499 " in log
    assert "ERROR" not in log
    assert "Traceback" not in log


def test_a_ready_file_that_cannot_be_written_is_told_in_one_line(
    server_environment: dict[str, str], tmp_path: Path
) -> None:
    arguments = (*COMMAND, "serve", "--port", "0", "--ready-file", str(tmp_path / "missing" / "ready"))
    done = subprocess.run(arguments, env=server_environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "slamcu-server: cannot write the ready file" in done.stderr
    assert "Traceback" not in done.stderr


def test_it_serves_and_stops(live_server: Any, vehicle_headers: dict[str, str]) -> None:
    assert httpx.get(f"{live_server.url}/readyz").json() == {"status": "ready"}
    answer = httpx.get(f"{live_server.url}/v1/maps", headers=vehicle_headers)
    assert answer.json()["maps"][0]["source"] == "town"
    assert "server" not in answer.headers
    assert live_server.stop() == 0
    log = live_server.log.read_text()
    assert f"listens on {live_server.url}" in log
    assert "Traceback" not in log
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"{live_server.url}/livez")


@contextmanager
def kept_connection(url: str) -> Iterator[HTTPConnection]:
    """Give a connection on which the server has answered once."""
    address = httpx.URL(url)
    with closing(HTTPConnection(address.host, address.port, timeout=60)) as connection:
        assert status_of_livez(connection) == 200
        yield connection


def status_of_livez(connection: HTTPConnection) -> int:
    connection.request("GET", "/livez")
    answer = connection.getresponse()
    answer.read()
    return answer.status


def test_an_idle_connection_is_kept_for_longer_than_clients_use_it(live_server: Any) -> None:
    with kept_connection(live_server.url) as connection:
        time.sleep((httpx.Limits().keepalive_expiry or 0.0) + 1.0)
        assert status_of_livez(connection) == 200


def test_an_idle_connection_is_closed_in_the_end(server_process: Any) -> None:
    server_process.environment["SLAMCU_KEEP_ALIVE_S"] = "1"
    server_process.start()
    with kept_connection(server_process.url) as connection:
        assert connection.sock.recv(1) == b""


def test_it_stops_while_a_client_dawdles(server_process: Any, vehicle_headers: dict[str, str]) -> None:
    server_process.environment["SLAMCU_SHUTDOWN_GRACE_S"] = "1"
    server_process.start()
    host, port = server_process.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as dawdler:
        head = "\r\n".join(f"{name}: {value}" for name, value in (vehicle_headers | PROTOBUF).items())
        dawdler.sendall(
            f"POST /v1/data-messages HTTP/1.1\r\nHost: x\r\nContent-Length: 999\r\n{head}\r\n\r\nx".encode()
        )
        httpx.get(f"{server_process.url}/livez")
        assert server_process.stop() == 0


def test_a_stop_does_not_wait_for_a_thread() -> None:
    """As one that looks up the name of a database that is gone, and is not told that there is no such name."""
    program = """if True:
        import asyncio, threading
        from slamcu_server.serving import run_to_end

        async def main():
            busy = threading.Event()
            lookup = asyncio.get_running_loop().run_in_executor(None, lambda: busy.set() or threading.Event().wait())
            while not busy.is_set():
                await asyncio.sleep(0.01)
            lookup.cancel()

        run_to_end(main())
    """
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=30, check=True)
    assert "without it" in ended.stderr


def test_an_acknowledged_message_survives_kill_9(
    server_process: Any, vehicle_headers: dict[str, str], database_url: str, make_report: MakeReport
) -> None:
    """Four vehicles upload while the server is killed three times; who gets no answer sends again."""
    sessions = [f"drive-{number}" for number in range(4)]
    batches = 40
    server_process.start()
    address = {"url": server_process.url}
    acknowledged: set[tuple[str, int]] = set()
    attempts: list[str] = []
    problems: list[str] = []

    def upload(session: str) -> None:
        with httpx.Client(headers=vehicle_headers | PROTOBUF, timeout=30) as client:
            for batch in range(batches):
                numbers = [2 * batch + 1, 2 * batch + 2]
                body = encode_batch([make_report(number, session_id=session) for number in numbers])
                while True:
                    attempts.append(session)
                    try:
                        answer = client.post(f"{address['url']}/v1/data-messages", content=body)
                    except httpx.TransportError:
                        time.sleep(0.02)
                        continue
                    if answer.status_code == 503:
                        time.sleep(0.02)
                        continue
                    if answer.status_code != 202 or answer.json()["rejected"]:
                        problems.append(answer.text)
                    acknowledged.update((session, number) for number in numbers)
                    break

    threads = [threading.Thread(target=upload, args=(session,)) for session in sessions]
    for thread in threads:
        thread.start()
    total = 2 * batches * len(sessions)
    for part in (1, 2, 3):
        while len(acknowledged) < total * part // 4 and any(thread.is_alive() for thread in threads):
            time.sleep(0.001)
        server_process.kill()
        stored = {(session, number) for session, number, _ in on(database_url, logged)}
        assert acknowledged <= stored  # at this very moment, not only in the end
        server_process.start()
        address["url"] = server_process.url
    for thread in threads:
        thread.join()
    assert problems == []
    assert len(attempts) > batches * len(sessions)  # the kills were felt
    stored = on(database_url, logged)
    assert sorted(stored) == sorted(
        (session, number, serialize_message(make_report(number, session_id=session)))
        for session in sessions
        for number in range(1, 2 * batches + 1)
    )
    assert server_process.stop() == 0


def test_what_was_logged_is_fused_in_the_end(
    server_process: Any, vehicle_headers: dict[str, str], database_url: str, make_report: MakeReport
) -> None:
    """The worker within the server is killed with it, and goes on where it was: every pass counts once."""
    server_process.start()
    reports = [make_report(number) for number in range(1, 201)]
    with httpx.Client(headers=vehicle_headers | PROTOBUF) as client:
        client.post(f"{server_process.url}/v1/data-messages", content=encode_batch(reports)).raise_for_status()
    server_process.kill()
    server_process.start()

    async def pending(engine: AsyncEngine) -> int:
        async with engine.connect() as connection:
            query = text("SELECT count(*) FROM messages WHERE state = 'pending'")
            return int((await connection.execute(query)).scalar_one())

    async def passes(engine: AsyncEngine) -> list[int]:
        async with engine.connect() as connection:
            query = text("SELECT count(*) FROM passes GROUP BY message")
            return list((await connection.execute(query)).scalars())

    deadline = time.monotonic() + 60
    while on(database_url, pending) > 0:
        assert time.monotonic() < deadline, server_process.log.read_text()
        time.sleep(0.1)
    assert on(database_url, passes) == [1] * 200
    assert server_process.stop() == 0


@pytest.mark.slow
def test_without_settings_it_keeps_a_database_of_its_own(short_dir: Path, server_environment: dict[str, str]) -> None:
    environment = {name: value for name, value in server_environment.items() if name != "SLAMCU_DATABASE_URL"}
    environment["SLAMCU_DATA_DIR"] = str(short_dir / "own")

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*COMMAND, *arguments], env=environment, capture_output=True, text=True, check=False)

    made = run("create-key", "--role", "provider")
    assert made.returncode == 0, made.stderr
    ready = short_dir / "ready"
    arguments = ["serve", "--port", "0", "--ready-file", str(ready)]
    with (short_dir / "own.log").open("w+") as log:
        server = subprocess.Popen([*COMMAND, *arguments], env=environment, stdout=log, stderr=log)
        try:
            deadline = time.monotonic() + 60
            while not ready.exists():
                assert server.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.02)
            headers = {"Authorization": f"Bearer {made.stdout.strip()}"}
            assert httpx.get(f"{ready.read_text().strip()}/v1/maps", headers=headers).json() == {"maps": []}
            beside = run("create-key", "--role", "vehicle")  # while the server runs, and it goes on running
            headers = {"Authorization": f"Bearer {beside.stdout.strip()}"}
            assert httpx.get(f"{ready.read_text().strip()}/v1/maps", headers=headers).status_code == 200
        finally:
            server.send_signal(signal.SIGINT)
            assert server.wait(timeout=30) == 0
        log.seek(0)
        assert "Traceback" not in log.read()
    assert not (short_dir / "own" / "cluster" / "data" / "postmaster.pid").exists()


def test_the_worker_alone_starts_and_stops(server_environment: dict[str, str]) -> None:
    worker = subprocess.Popen(
        [*COMMAND, "worker"], env=server_environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert worker.stdout is not None
    assert "aggregating" in worker.stdout.readline()
    worker.send_signal(signal.SIGTERM)
    _, said = worker.communicate(timeout=30)
    assert worker.returncode == 0
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("arguments", "environment", "expected"),
    [
        (["serve", "--port", "70000"], {}, "SLAMCU_PORT"),
        (["serve"], {"SLAMCU_PORT": "http"}, "SLAMCU_PORT"),
        (
            ["serve"],
            {"SLAMCU_DATABASE_URL": "mysql://root:secret@x/y"},
            "SLAMCU_DATABASE_URL: must begin with postgresql",
        ),
        (["worker"], {"SLAMCU_DATABASE_URL": "postgresql://nobody@127.0.0.1:1/x"}, "not reachable"),
        (["serve"], {"SLAMCU_POLICY_FILE": "/nonexistent.json"}, "/nonexistent.json"),
        (["serve", "--no-worker"], {"SLAMCU_POLICY_FILE": "/nonexistent.json"}, "/nonexistent.json"),
        (["serve", "--host", "host.invalid"], {}, "host.invalid"),
        (["serve", "--data-dir", "/dev/null/x"], {"SLAMCU_DATABASE_URL": ""}, "SLAMCU_DATA_DIR"),
    ],
)
def test_what_keeps_it_from_starting_is_told_in_one_line(
    command: Callable[..., subprocess.CompletedProcess[str]],
    arguments: list[str],
    environment: dict[str, str],
    expected: str,
) -> None:
    done = command(*arguments, **({} if "--port" in arguments else {"SLAMCU_PORT": "0"}) | environment)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1, done.stderr
    assert expected in done.stderr
    assert "secret" not in done.stderr


def test_a_port_in_use_is_told(command: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = command("serve", "--port", str(port))
    assert done.returncode == 1
    assert f"cannot listen on 127.0.0.1 port {port}" in done.stderr


def test_an_old_schema_is_told(command: Callable[..., subprocess.CompletedProcess[str]], database_url: str) -> None:
    async def forget(engine: AsyncEngine) -> None:
        async with engine.begin() as connection:
            await connection.execute(text("DELETE FROM alembic_version"))

    on(database_url, forget)
    done = command("list-keys")
    assert done.returncode == 1
    assert "run slamcu-server migrate" in done.stderr


def test_help_is_there_for_every_command(command: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    for name in ("serve", "worker", "migrate", "import-map", "create-key", "rotate-key", "revoke-key", "list-keys"):
        done = command(name, "--help")
        assert done.returncode == 0
        assert name in done.stdout
