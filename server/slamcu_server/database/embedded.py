"""A private PostgreSQL cluster with PostGIS in a data directory, shared by the processes that use it."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import secrets
import shlex
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self
from urllib.parse import quote

from slamcu_server.database.postgres_tools import EmbeddedDatabaseError, PostgresTools, RunAs

logger = logging.getLogger(__name__)

DATABASE = "slamcu"
_SUPERUSER = "slamcu"
_SOCKET_PATH_MAX = 107  # bytes, of sockaddr_un
_SOCKET_NAME = ".s.PGSQL.5432"
# Where a socket goes whose path would be too long; mkdtemp makes it private.
_ELSEWHERE, _PREFIX = Path("/tmp"), "slamcu-"  # noqa: S108
_START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 8.0
_PAUSE_S = 0.1
_LOG_MAX_BYTES = 10 * 2**20
_NO_PID = 2**31 - 2  # above every system's greatest process id


class EmbeddedCluster:
    """Start, share and stop the cluster in `data_dir`, as a context manager.

    Each process that uses the cluster holds a shared lock; the last one to leave stops the cluster. A process that is
    killed loses its lock with its life, so the next one to come finds the cluster running and takes it over.
    The cluster listens on a Unix socket in a directory that only its user may enter, and nowhere else.

    Layout of `data_dir`: `cluster/data` (PostgreSQL's), `cluster/run` (the socket), `cluster/server.log`, `*.lock`.
    """

    def __init__(self, data_dir: Path, *, bin_dir: Path | None = None) -> None:
        self._home = data_dir
        self._cluster = data_dir / "cluster"
        self._data = self._cluster / "data"
        self._log = self._cluster / "server.log"
        self._bin_dir = bin_dir
        self._users: int | None = None
        self._tools: PostgresTools | None = None

    @property
    def url(self) -> str:
        """The SQLAlchemy URL of the cluster's database."""
        return self.url_of(DATABASE)

    def url_of(self, database: str) -> str:
        """Return the SQLAlchemy URL of a database in this cluster."""
        return f"postgresql+asyncpg://{_SUPERUSER}@/{database}?host={quote(str(self._socket_dir()), safe='/')}"

    def __enter__(self) -> Self:
        user = RunAs.current()
        self._prepare_directories(user)
        with self._control():
            users = os.open(self._home / "users.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(users, fcntl.LOCK_SH)
                self._tools = self._find_tools(user)
                self._initialise(self._tools)
                self._start(self._tools)
            except BaseException:
                os.close(users)
                raise
            self._users = users
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._users is None or self._tools is None:
            return
        with self._control():
            try:
                fcntl.flock(self._users, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                logger.debug("others still use the cluster in %s", self._home)
            else:
                self._stop(self._tools)
            finally:
                os.close(self._users)
                self._users = None

    @contextlib.contextmanager
    def _control(self) -> Iterator[None]:
        """Let one process at a time start or stop the cluster."""
        control = os.open(self._home / "control.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(control, fcntl.LOCK_EX)
            yield
        finally:
            os.close(control)

    def _prepare_directories(self, user: RunAs) -> None:
        try:
            self._home.mkdir(parents=True, exist_ok=True, mode=0o711 if user.drop else 0o700)
            if user.drop:
                self._home.chmod(self._home.stat().st_mode | 0o011)
            self._cluster.mkdir(exist_ok=True, mode=0o700)
            if user.drop:
                os.chown(self._cluster, user.uid, user.gid)
        except OSError as error:
            raise EmbeddedDatabaseError(
                f"cannot use the data directory {self._home}: {error.strerror}; set SLAMCU_DATA_DIR to another"
            ) from error

    def _find_tools(self, user: RunAs) -> PostgresTools:
        version = self._data / "PG_VERSION"
        major = version.read_text().strip() if version.exists() else None
        return PostgresTools.find(user, bin_dir=self._bin_dir, major=major)

    def _initialise(self, tools: PostgresTools) -> None:
        for abandoned in self._cluster.glob("new-*"):
            shutil.rmtree(abandoned, ignore_errors=True)
        if self._data.exists():
            return
        # Renamed when complete: a kill in between leaves no half cluster. A name of its own: an initdb whose parent was
        # killed may still be at work in another.
        unfinished = self._cluster / f"new-{secrets.token_hex(4)}"
        options = ("--username", _SUPERUSER, "--auth=trust", "--encoding=UTF8", "--locale=C.UTF-8")
        result = tools.run("initdb", "--pgdata", unfinished.name, *options, cwd=self._cluster)
        if result.returncode != 0:
            if "ermission denied" in result.stdout:
                raise EmbeddedDatabaseError(
                    f"the user {tools.user.name}, as whom PostgreSQL must run in place of root, cannot enter "
                    f"{self._home}: set SLAMCU_DATA_DIR to a directory whose parents everyone may enter"
                )
            raise EmbeddedDatabaseError(f"initdb failed in {self._cluster}: {_last_line(result.stdout)}")
        unfinished.rename(self._data)

    def _start(self, tools: PostgresTools) -> None:
        deadline = time.monotonic() + _START_TIMEOUT_S
        while not self._ready(tools):
            if time.monotonic() > deadline:
                raise EmbeddedDatabaseError(f"PostgreSQL does not get ready (see {self._log})")
            self._disown_dead_pid()
            if tools.run("pg_ctl", "status", "--pgdata", self._data.name, cwd=self._cluster).returncode == 0:
                time.sleep(_PAUSE_S)  # it runs: it is recovering from a crash, or about to stop
            else:
                self._launch(tools)
        self._ensure_database(tools)

    def _launch(self, tools: PostgresTools) -> None:
        if self._log.exists() and self._log.stat().st_size > _LOG_MAX_BYTES:
            self._log.replace(self._log.with_suffix(".log.1"))
        said_before = self._log.stat().st_size if self._log.exists() else 0
        socket_dir = self._new_socket_dir(tools.user)
        options = f"-k {shlex.quote(str(socket_dir))} -c listen_addresses= -c port=5432 -c log_min_messages=warning"
        result = tools.run(
            "pg_ctl", "start", "--wait", "--silent", "--pgdata", self._data.name, "--log", self._log.name,
            "--options", options, "--timeout", str(int(_START_TIMEOUT_S)),
            cwd=self._cluster,  # pg_ctl hands paths to a shell: relative ones need no quoting
            timeout=_START_TIMEOUT_S + 10,
        )  # fmt: skip
        if result.returncode == 0:
            return
        said = self._log.read_bytes()[said_before:].decode(errors="replace") if self._log.exists() else result.stdout
        if "still in use" in said:  # children of a postmaster that was killed take a moment to notice
            time.sleep(_PAUSE_S)
            return
        self._remove_socket_dir(socket_dir)
        fatal = [line for line in said.splitlines() if "FATAL" in line]
        raise EmbeddedDatabaseError(
            f"PostgreSQL did not start: {_last_line(fatal[0] if fatal else said)} (see {self._log})"
        )

    def _ready(self, tools: PostgresTools) -> bool:
        try:
            socket_dir = self._socket_dir()
        except EmbeddedDatabaseError:
            return False
        return tools.run("pg_isready", "--quiet", "--host", str(socket_dir)).returncode == 0

    def _ensure_database(self, tools: PostgresTools) -> None:
        connection = ("--host", str(self._socket_dir()), "--username", _SUPERUSER)
        query = f"SELECT count(*) FROM pg_database WHERE datname = '{DATABASE}'"  # noqa: S608  (a constant)
        found = tools.run("psql", *connection, "--no-psqlrc", "--dbname", "postgres", "-tAc", query)
        if found.returncode != 0:
            raise EmbeddedDatabaseError(f"PostgreSQL does not answer: {_last_line(found.stdout)}")
        if found.stdout.strip() == "0":
            created = tools.run("createdb", *connection, "--maintenance-db", "postgres", DATABASE)
            if created.returncode != 0:
                raise EmbeddedDatabaseError(f"cannot create the database: {_last_line(created.stdout)}")

    def _stop(self, tools: PostgresTools) -> None:
        socket_dir = self._socket_dir()
        try:
            result = tools.run(
                "pg_ctl", "stop", "--mode", "fast", "--silent", "--pgdata", self._data.name,
                "--timeout", str(int(_STOP_TIMEOUT_S)), cwd=self._cluster, timeout=_STOP_TIMEOUT_S + 5,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            logger.warning("the cluster in %s takes long to stop; it goes on doing so by itself", self._home)
            return
        if result.returncode != 0:
            logger.warning("could not stop the cluster in %s: %s", self._home, _last_line(result.stdout))
        else:
            self._remove_socket_dir(socket_dir)

    def _socket_dir(self) -> Path:
        """Read the socket's directory from the running postmaster's pid file."""
        try:
            return Path((self._data / "postmaster.pid").read_text().splitlines()[4])
        except (FileNotFoundError, IndexError):
            raise EmbeddedDatabaseError(f"the cluster in {self._home} is not running") from None

    def _new_socket_dir(self, user: RunAs) -> Path:
        with contextlib.suppress(EmbeddedDatabaseError):
            self._remove_socket_dir(self._socket_dir())  # of a postmaster that was killed
        directory = self._cluster / "run"
        if len(os.fsencode(directory / _SOCKET_NAME)) > _SOCKET_PATH_MAX or "," in str(directory):
            directory = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=_ELSEWHERE))
        else:
            directory.mkdir(exist_ok=True, mode=0o700)
            (directory / f"{_SOCKET_NAME}.lock").unlink(missing_ok=True)  # it names the process that was killed
        if user.drop:
            os.chown(directory, user.uid, user.gid)
        return directory

    def _remove_socket_dir(self, directory: Path) -> None:
        if directory.parent == _ELSEWHERE and directory.name.startswith(_PREFIX):
            shutil.rmtree(directory, ignore_errors=True)

    def _disown_dead_pid(self) -> None:
        """Put a process id that nobody has into the pid file, if it names a zombie or a process that is not ours.

        PostgreSQL takes both for a postmaster that runs: the zombie of one that was killed where nobody reaps it, and
        whoever has its id after a container's restart. The file itself stays, because PostgreSQL finds in it whether
        children of the killed one still live.
        """
        pid_file = self._data / "postmaster.pid"
        try:
            lines = pid_file.read_text().splitlines(keepends=True)
            command, _, state = Path(f"/proc/{int(lines[0])}/stat").read_text().partition("(")[2].rpartition(") ")
        except (FileNotFoundError, IndexError, ValueError):
            return  # no pid file, no such process, or no /proc: PostgreSQL sorts these out itself
        if not command.startswith("postgres") or state.startswith("Z"):
            pid_file.write_text("".join([f"{_NO_PID}\n", *lines[1:]]))


def _last_line(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    return lines[-1] if lines else "no message"
