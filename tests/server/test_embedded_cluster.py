"""The private cluster: shared by processes, stopped by the last, and found again after any kill -9."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import asyncpg
import pytest

from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.postgres_tools import EmbeddedDatabaseError, PostgresTools, RunAs

_HOLD = """
import sys
from pathlib import Path
from slamcu_server.database.embedded import EmbeddedCluster
with EmbeddedCluster(Path(sys.argv[1])) as cluster:
    print(cluster.url, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(scope="module")
def home(short_dir: Path) -> Path:
    """A data directory with a cluster that was stopped properly."""
    directory = short_dir / "private"
    with EmbeddedCluster(directory):
        pass
    return directory


Hold = Callable[[], "subprocess.Popen[str]"]


@pytest.fixture
def hold(home: Path) -> Iterator[Hold]:
    """`hold()`: another process that uses the cluster until its standard input ends."""
    started: list[subprocess.Popen[str]] = []

    def start() -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", _HOLD, str(home)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline().startswith("postgresql+asyncpg://")
        return process

    yield start
    for process in started:
        leave(process)


def leave(process: subprocess.Popen[str]) -> None:
    process.communicate()


def query(cluster: EmbeddedCluster, sql: str) -> Any:
    async def ask() -> Any:
        connection = await asyncpg.connect(cluster.url.replace("+asyncpg", ""))
        try:
            return await connection.fetchval(sql)
        finally:
            await connection.close()

    return asyncio.run(ask())


def postmaster(home: Path) -> int | None:
    """The process id of the running postmaster."""
    try:
        return int((home / "cluster" / "data" / "postmaster.pid").read_text().splitlines()[0])
    except FileNotFoundError:
        return None


def test_it_is_durable_and_listens_to_nobody_else(home: Path) -> None:
    with EmbeddedCluster(home) as cluster:
        assert query(cluster, "SHOW fsync") == "on"
        assert query(cluster, "SHOW synchronous_commit") == "on"
        assert query(cluster, "SHOW listen_addresses") == ""
        assert query(cluster, "SELECT count(*) FROM pg_available_extensions WHERE name = 'postgis'") == 1
        socket_dir = Path(query(cluster, "SHOW unix_socket_directories"))
        assert socket_dir.stat().st_mode & 0o077 == 0
        # Whoever cannot enter this directory cannot reach the socket in any case.
        assert (home / "cluster").stat().st_mode & 0o077 == 0
    assert postmaster(home) is None


def test_the_last_to_leave_stops_it(home: Path, hold: Hold) -> None:
    first, second = hold(), hold()
    running = postmaster(home)
    with EmbeddedCluster(home) as cluster:
        leave(first)
        assert query(cluster, "SELECT 1") == 1
    assert postmaster(home) == running
    leave(second)
    assert postmaster(home) is None


def test_a_killed_user_leaves_it_to_the_next(home: Path, hold: Hold) -> None:
    killed = hold()
    running = postmaster(home)
    killed.kill()
    killed.wait()
    assert postmaster(home) == running
    with EmbeddedCluster(home) as cluster:
        assert postmaster(home) == running
        assert query(cluster, "SELECT 1") == 1
    assert postmaster(home) is None


def test_a_killed_postmaster_is_started_again_with_what_was_committed(home: Path, hold: Hold) -> None:
    holder = hold()
    cluster = EmbeddedCluster(home)
    query(cluster, "CREATE TABLE IF NOT EXISTS kept (n int)")
    query(cluster, "INSERT INTO kept VALUES (1)")
    killed = postmaster(home)
    assert killed is not None
    os.kill(killed, signal.SIGKILL)
    with cluster:
        assert postmaster(home) != killed
        assert query(cluster, "SELECT count(*) FROM kept") == 1
    leave(holder)
    assert postmaster(home) is None


def test_a_pid_file_whose_id_is_another_process_s_now_is_no_obstacle(home: Path, hold: Hold) -> None:
    holder = hold()
    pid_file = home / "cluster" / "data" / "postmaster.pid"
    lines = pid_file.read_text().splitlines()
    owner = pid_file.stat()
    leave(holder)
    pid_file.write_text("\n".join([str(os.getpid()), *lines[1:]]) + "\n")
    os.chown(pid_file, owner.st_uid, owner.st_gid)
    with EmbeddedCluster(home) as cluster:
        assert query(cluster, "SELECT 1") == 1


def test_many_may_come_at_once(home: Path) -> None:
    code = _HOLD.replace("sys.stdin.read()", "")
    processes = [
        subprocess.Popen([sys.executable, "-c", code, str(home)], stdout=subprocess.PIPE, text=True) for _ in range(4)
    ]
    assert [process.communicate()[0].startswith("postgresql") for process in processes] == [True] * 4
    assert [process.returncode for process in processes] == [0] * 4
    assert postmaster(home) is None


def test_a_start_that_was_killed_halfway_is_begun_again(short_dir: Path) -> None:
    home = short_dir / "halfway"
    process = subprocess.Popen([sys.executable, "-c", _HOLD, str(home)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    deadline = time.monotonic() + 60
    while not list((home / "cluster").glob("new-*/PG_VERSION")):  # initdb has begun
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.001)
    process.kill()
    process.communicate()
    assert not (home / "cluster" / "data").exists()
    with EmbeddedCluster(home) as cluster:
        assert query(cluster, "SELECT 1") == 1


def test_a_long_path_and_a_strange_one_are_no_obstacle(short_dir: Path) -> None:
    home = short_dir / ("a data directory, with 'quotes' and $signs " + "x" * 80)
    with EmbeddedCluster(home) as cluster:
        assert query(cluster, "SELECT 1") == 1
        elsewhere = Path(query(cluster, "SHOW unix_socket_directories"))
        assert home not in elsewhere.parents
        assert elsewhere.stat().st_mode & 0o077 == 0
        killed = postmaster(home)
        assert killed is not None
        os.kill(killed, signal.SIGKILL)
        with EmbeddedCluster(home) as again:
            assert query(again, "SELECT 1") == 1
            assert not elsewhere.exists()
            elsewhere = Path(query(again, "SHOW unix_socket_directories"))
    assert not elsewhere.exists()


def test_missing_software_is_told_in_one_line(short_dir: Path) -> None:
    with pytest.raises(EmbeddedDatabaseError, match=r"PostgreSQL with PostGIS is not found: .*make setup") as told:
        PostgresTools.find(RunAs.current(), bin_dir=short_dir)
    assert "\n" not in str(told.value)
    with pytest.raises(EmbeddedDatabaseError, match=r"PostgreSQL 7's, which is not installed"):
        PostgresTools.find(RunAs.current(), major="7")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root must become another user")
def test_root_is_told_when_the_other_user_cannot_get_there(short_dir: Path) -> None:
    closed = short_dir / "closed"
    closed.mkdir(mode=0o700)
    with (
        pytest.raises(EmbeddedDatabaseError, match=r"cannot enter .*SLAMCU_DATA_DIR") as told,
        EmbeddedCluster(closed / "data"),
    ):
        raise AssertionError("unreachable")
    assert "\n" not in str(told.value)


def test_a_data_directory_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EmbeddedDatabaseError, match="SLAMCU_DATA_DIR"), EmbeddedCluster(tmp_path / "file" / "data"):
        raise AssertionError("unreachable")
