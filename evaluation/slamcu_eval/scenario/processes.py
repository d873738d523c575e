"""The system as plain processes on this machine: a private PostGIS, two servers, two workers, relays before them."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self
from urllib.parse import unquote, urlsplit

from slamcu_eval.fleet.program import Program, run_server_command
from slamcu_eval.scenario import next_release
from slamcu_eval.scenario.ports import free_port
from slamcu_eval.scenario.relay import Relay
from slamcu_eval.scenario.system import APIS, DATABASE, WORKERS, Car, SystemFaultError
from slamcu_server.database.embedded import DATABASE as DATABASE_NAME
from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.postgres_tools import PostgresTools, RunAs

_START_TIMEOUT_S = 60.0
_POLL_S = 0.05
_TEND_S = 0.2


class ProcessSystem:
    """Run the system's programs as processes of this user, as a context manager.

    A service that was killed is started again at once, as the restart policy of the containers does it.

    Parameters
    ----------
    logs : a folder for what the programs say.
    """

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self._stack = ExitStack()
        self._clusters: list[EmbeddedCluster] = []
        self._programs: dict[str, Program] = {}
        self._worker_ports: dict[str, int] = {}
        self._cars: dict[str, subprocess.Popen[bytes]] = {}
        self._environment: dict[str, str] = {}
        self._next: dict[str, str] = {}
        self._lock = threading.Lock()  # held while programs are started or stopped on purpose
        self._ending = threading.Event()
        self._database_is_up = threading.Event()
        self.url = ""
        self.home = Path()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._logs.mkdir(parents=True, exist_ok=True)
            home = tempfile.TemporaryDirectory(prefix="slamcu-", ignore_cleanup_errors=True)
            self.home = Path(stack.enter_context(home))
            self.home.chmod(0o711)  # PostgreSQL does not run as root, and must be able to get to its directory
            stack.callback(self._leave_database)
            stack.callback(self._kill_all)
            self._open_database()
            clean = {name: value for name, value in os.environ.items() if not name.startswith("SLAMCU_")}
            self._environment = clean | {
                "SLAMCU_DATABASE_URL": self._clusters[-1].url,
                "SLAMCU_LOG_LEVEL": "warning",
                "OMP_NUM_THREADS": "1",
            }
            self._next = self._environment | {"PYTHONPATH": str(next_release.make_package(self.home / "next"))}
            self.command("migrate")
            self._start_services(self._environment)
            keeper = threading.Thread(target=self._keep_running, name="keeper", daemon=True)
            keeper.start()
            stack.callback(keeper.join)
            stack.callback(self._ending.set)
            front = stack.enter_context(Relay(self._backends))
            self._road = stack.enter_context(Relay(self._backends))
            self.url = front.url
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    # --- commands and cars ------------------------------------------------------------------------------------------

    def command(self, *arguments: str | Path) -> str:
        """Run a command of `slamcu-server` and return its output; raise ProgramError if it fails."""
        return run_server_command([str(one) for one in arguments], self._environment)

    def start_car(self, car: Car) -> None:
        """Let a car drive."""
        environment = self._environment | {"SLAMCU_API_KEY_FILE": str(car.key_file)}
        del environment["SLAMCU_DATABASE_URL"]
        with (self._logs / f"{car.name}.log").open("ab") as log:
            self._cars[car.name] = subprocess.Popen(  # noqa: S603  (our own program)
                [sys.executable, "-m", "slamcu_client", *car.arguments(self._road.url)],
                env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip

    def cars_under_way(self) -> int:
        """Return how many cars have not come to the end; raise SystemFaultError if one failed."""
        for name, process in self._cars.items():
            if process.poll():
                said = (self._logs / f"{name}.log").read_text(encoding="utf-8", errors="replace").strip()
                raise SystemFaultError(f"{name} ended with {process.returncode}: {said[-500:]}")
        return sum(process.poll() is None for process in self._cars.values())

    # --- faults -----------------------------------------------------------------------------------------------------

    def kill(self, service: str) -> None:
        """Kill a service with SIGKILL; the keeper starts it again."""
        if service == DATABASE:
            os.kill(int((self._data / "postmaster.pid").read_text().split()[0]), signal.SIGKILL)
            self._database_is_up.clear()
        else:
            with self._lock:
                self._programs[service].kill()
                self._ready_file(service).unlink(missing_ok=True)

    def cut_network(self) -> None:
        """Break the cars' connections and refuse new ones."""
        self._road.cut()

    def mend_network(self) -> None:
        """Let the cars through again."""
        self._road.mend()

    def ailing(self) -> list[str]:
        """Return what does not run or does not say that it is ready."""
        found = []
        if not self._database_is_up.is_set():
            found.append("database: it is starting")
        for service, program in self._programs.items():
            if not program.alive or self._port(service) is None:
                found.append(f"{service}: it is starting")
                continue
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{self._port(service)}/readyz", timeout=6):
                    pass
            except OSError as error:
                said = error.read().decode() if isinstance(error, urllib.error.HTTPError) else str(error)
                found.append(f"{service}: {said}")
        return found

    # --- upgrade, backup, end ---------------------------------------------------------------------------------------

    def migrate_to_next(self) -> None:
        """Bring the schema to that of the next release."""
        run_server_command(["migrate"], self._next)

    def upgrade(self, service: str) -> None:
        """Stop a service in order and start its next release."""
        with self._lock:
            self._programs[service].stop()
            self._start(service, self._next)

    def back_up(self, path: Path) -> None:
        """Write a dump of the database."""
        self._postgres("pg_dump", "--format=custom", "--file", str(path), DATABASE_NAME)

    def destroy_and_restore(self, path: Path) -> None:
        """Stop the services, remove the cluster's files, and make a new cluster of the dump."""
        with self._lock:
            for program in self._programs.values():
                program.stop()
            self._leave_database()
            shutil.rmtree(self.home / "data")
            self._open_database()
            self._postgres("pg_restore", "--exit-on-error", "--dbname", DATABASE_NAME, str(path))
            self._start_services(self._next)

    def stop(self) -> list[str]:
        """Stop the services in order; return which were killed after ten seconds."""
        with self._lock:
            self._ending.set()
            return [service for service, program in self._programs.items() if program.stop(10.0) != 0]

    # --- within -----------------------------------------------------------------------------------------------------

    @property
    def _data(self) -> Path:
        return self.home / "data" / "cluster" / "data"

    def _open_database(self) -> None:
        cluster = EmbeddedCluster(self.home / "data")
        cluster.__enter__()
        self._clusters.append(cluster)
        self._database_is_up.set()

    def _keep_running(self) -> None:
        """Start again what was killed, or found no database when it started: the restart policy of the containers."""
        while not self._ending.wait(_TEND_S):
            if not self._database_is_up.is_set():
                self._open_database()
            with self._lock:
                for program in self._programs.values():
                    if not (program.alive or self._ending.is_set()):
                        program.start()

    def _leave_database(self) -> None:
        while self._clusters:
            self._clusters.pop().__exit__(None, None, None)

    def _start_services(self, environment: dict[str, str]) -> None:
        for service in (*APIS, *WORKERS):
            self._start(service, environment)
        deadline = time.monotonic() + _START_TIMEOUT_S
        while found := self.ailing():
            if time.monotonic() > deadline:
                raise SystemFaultError(f"the services did not start: {'; '.join(found)}")
            time.sleep(_POLL_S)

    def _start(self, service: str, environment: dict[str, str]) -> None:
        """Start a service without waiting for it: `ailing` tells when it is ready."""
        arguments: tuple[str, ...] = ("worker",)
        if service in APIS:
            self._ready_file(service).unlink(missing_ok=True)
            arguments = ("serve", "--no-worker", "--port", "0", "--ready-file", str(self._ready_file(service)))
        else:
            self._worker_ports[service] = free_port()
            environment = environment | {"SLAMCU_WORKER_PORT": str(self._worker_ports[service])}
        self._programs[service] = Program(arguments, environment, self._logs / f"{service}.log")
        self._programs[service].start()

    def _ready_file(self, service: str) -> Path:
        return self.home / f"{service}.ready"

    def _port(self, service: str) -> int | None:
        """Return where a service listens; None: it does not yet."""
        if service in WORKERS:
            return self._worker_ports[service]
        with contextlib.suppress(FileNotFoundError):
            return urlsplit(self._ready_file(service).read_text(encoding="utf-8").strip()).port
        return None

    def _backends(self) -> list[tuple[str, int]]:
        return [("127.0.0.1", port) for service in APIS if (port := self._port(service))]

    def _postgres(self, program: str, *arguments: str) -> None:
        tools = PostgresTools.find(RunAs.current(), major=(self._data / "PG_VERSION").read_text().strip())
        host = unquote(urlsplit(self._clusters[-1].url).query.removeprefix("host="))
        user = urlsplit(self._clusters[-1].url).username or ""
        command = [str(tools.bin_dir / program), "--host", host, "--username", user, *arguments]
        done = subprocess.run(command, check=False, capture_output=True, text=True)  # noqa: S603
        if done.returncode != 0:
            raise SystemFaultError(f"{program} failed: {done.stderr.strip()}")

    def _kill_all(self) -> None:
        for process in self._cars.values():
            if process.poll() is None:
                process.kill()
            process.wait()
        for program in self._programs.values():
            program.stop()
