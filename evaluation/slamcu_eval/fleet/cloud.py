"""A private server for an evaluation: a real `slamcu-server` process on a PostGIS cluster of its own."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from slamcu_client import Server
from slamcu_core.aggregation import Policy
from slamcu_eval.fleet.program import Program, ProgramError
from slamcu_eval.fleet.provider import CloudError, Provider
from slamcu_eval.signals import ctrl_c_held_back, signals_as_exit
from slamcu_server.database.embedded import EmbeddedCluster

_START_TIMEOUT_S = 60.0
_POLL_S = 0.1


class Cloud(Provider):
    """Run a private server as a context manager; leave no process and no file behind, whatever happens.

    ::

        with Cloud() as cloud:
            cloud.import_map(path)
            keys = cloud.create_keys("vehicle", 10)
            ...                                  # vehicles report to cloud.url
            cloud.wait_until_fused()
            cloud.get("/v1/changes")

    Ctrl-C, SIGTERM and SIGHUP reach this process only, which then stops the server in order.

    Parameters
    ----------
    policy : the aggregation policy; None: the server's own.
    own_worker : aggregate in a process of its own (`worker`) instead of the server's.
    settings : further environment variables of the server (`SLAMCU_…`).
    """

    def __init__(
        self, *, policy: Policy | None = None, own_worker: bool = False, settings: Mapping[str, str] | None = None
    ) -> None:
        super().__init__()
        self._policy, self._own_worker, self._settings = policy, own_worker, dict(settings or {})
        self._stack = ExitStack()
        self._batches = 0
        self.url = ""
        self.provider_key = ""

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(signals_as_exit())
            with ctrl_c_held_back():  # an import may swallow it, or make another error of it
                from slamcu_eval.fleet import office  # noqa: F401, PLC0415
            home = tempfile.TemporaryDirectory(prefix="slamcu-", ignore_cleanup_errors=True)
            self._home = Path(stack.enter_context(home))
            self._home.chmod(0o711)  # PostgreSQL does not run as root, and must be able to get to its directory
            self.scratch.mkdir()
            self._environment = self._private_environment()
            self._server = self._program("serve", "--worker" if not self._own_worker else "--no-worker")
            self.worker = Program(("worker",), self._environment, self._home / "worker.log")
            for leave in (self._stop_cluster, self.worker.stop, self._server.stop):
                stack.callback(leave)
            self.start()
            if self._own_worker:
                self.worker.start()
            (self.provider_key,) = self.create_keys("provider", 1)
            self._provider = stack.enter_context(Server(self.url, self.provider_key))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    # --- the process ------------------------------------------------------------------------------------------------

    @property
    def pid(self) -> int:
        """Process id of the server; raises ProgramError if it is not running."""
        return self._server.pid

    @property
    def data_dir(self) -> Path:
        """Home of the server's cluster."""
        return self._home / "data"

    @property
    def scratch(self) -> Path:
        """A folder for what belongs to the evaluation, such as the vehicles' outboxes; it goes with the server."""
        return self._home / "scratch"

    def start(self) -> None:
        """Start the server and wait until it answers; after the first time at the same address as before.

        Raises CloudError if it does not.
        """
        self._ready_file.unlink(missing_ok=True)
        self._server.start()
        deadline = time.monotonic() + _START_TIMEOUT_S
        while not self._ready_file.exists():
            try:
                self._server.check()
            except ProgramError as error:
                raise CloudError(f"the server did not start: {error}") from None
            if time.monotonic() > deadline:
                raise CloudError(f"the server did not start in {_START_TIMEOUT_S:g} s: {self._server.last_words()}")
            time.sleep(_POLL_S / 2)
        self.url = self._ready_file.read_text(encoding="utf-8").strip()
        # where the vehicles will look for it again
        self._environment["SLAMCU_PORT"] = self.url.rsplit(":", 1)[1]

    def kill(self) -> None:
        """Kill the server as a crash would (SIGKILL); `start` brings it back on the same data."""
        self._server.kill()

    def wait(self) -> None:
        """Wait until the server ends by itself, and raise ProgramError then, for it should not."""
        self._server.wait()
        self._server.check()

    @property
    def _ready_file(self) -> Path:
        return self._home / "ready"

    def _program(self, *arguments: str) -> Program:
        arguments = (*arguments, "--ready-file", str(self._ready_file))
        return Program(arguments, self._environment, self._home / "server.log")

    def _stop_cluster(self) -> None:
        """Stop the cluster that a killed server left running: the last user to leave does it."""
        if (self.data_dir / "cluster" / "data" / "postmaster.pid").exists():
            with EmbeddedCluster(self.data_dir):
                pass

    def _private_environment(self) -> dict[str, str]:
        """Return the environment without the settings of the user's own server."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith("SLAMCU_")}
        environment |= {"SLAMCU_DATA_DIR": str(self.data_dir), "SLAMCU_LOG_LEVEL": "warning", "SLAMCU_PORT": "0"}
        environment |= self._settings
        if self._policy is not None:
            path = self._home / "policy.json"
            path.write_text(json.dumps(self._policy.to_document()), encoding="utf-8")
            environment["SLAMCU_POLICY_FILE"] = str(path)
        return environment

    # --- what is done with it ---------------------------------------------------------------------------------------

    def import_map(self, path: Path) -> None:
        """Import an HD map (GeoJSON); raises SlamcuError if the file cannot be used."""
        from slamcu_eval.fleet import office  # noqa: PLC0415  (vehicles' processes need none of the server)

        office.import_map(self.data_dir, self._policy or Policy(), path)

    def create_keys(self, role: str, count: int) -> list[str]:
        """Make accounts of a role, and return a key of each."""
        from slamcu_eval.fleet import office  # noqa: PLC0415

        self._batches += 1  # labels are unique, and another batch may come
        labels = [f"{role}-{self._batches}-{number}" for number in range(1, count + 1)]
        return office.create_keys(self.data_dir, role, labels)

    def pending(self) -> int:
        """Return how many messages wait to be fused; raise CloudError if one was put aside as unusable."""
        values = self._metrics("slamcu_aggregation_pending_messages", "slamcu_aggregation_quarantined_messages")
        if values[1]:
            raise CloudError(f"{values[1]:.0f} messages could not be fused: {self._server.last_words()}")
        return int(values[0])

    def wait_until_fused(
        self, timeout_s: float = 120.0, pending: Callable[[], int] | None = None, poll_s: float = _POLL_S
    ) -> None:
        """Wait until everything that was acknowledged is fused; `pending` counts what is not, where that is cheaper.

        Raises CloudError if it takes too long, a message could not be fused, or the server is gone.
        """
        deadline = time.monotonic() + timeout_s
        while left := (pending or self.pending)():
            self._server.check()
            if time.monotonic() > deadline:
                raise CloudError(
                    f"{left} messages still wait to be fused after {timeout_s:g} s: {self._server.last_words()}"
                )
            time.sleep(poll_s)

    def _metrics(self, *names: str) -> list[float]:
        lines = self.request("GET", "/metrics").content.decode().split("\n")
        found = dict(line.rsplit(" ", 1) for line in lines if line and not line.startswith("#"))
        try:
            return [float(found[name]) for name in names]
        except KeyError as error:
            raise CloudError(f"the server's metrics lack {error}") from None
