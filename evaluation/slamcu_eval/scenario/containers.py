"""The system in containers: docker-compose.yml as it stands, with cars beside it on a network of their own."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from slamcu_eval.scenario import next_release
from slamcu_eval.scenario.ports import free_port
from slamcu_eval.scenario.system import DATABASE, SERVICES, Car, SystemFaultError

_PROXY = "proxy"
_SAME_IN_NEXT = ("database", "proxy")  # images that the next release has not changed
_USER = 10001  # of the images
_START_TIMEOUT_S = 240.0
_POLL_S = 0.5
_FORCED = (137, 143)  # ended by SIGKILL, or by SIGTERM without having handled it


class ContainerSystem:
    """Start the system with `docker compose` (v2) or `docker-compose` (1.29), as a context manager.

    The images are those of `make images`. Everything is made under a project name of its own and removed at the end:
    containers, networks, volumes, and the image of the next release.

    Parameters
    ----------
    root : the tree with docker-compose.yml.
    home : a folder for the files that are shown to containers.
    logs : a folder for what the containers say.
    port : where the API is published on this machine; without one, at a port that is free.
    """

    def __init__(self, root: Path, home: Path, logs: Path, *, port: int | None = None) -> None:
        self._root, self.home, self._logs = root, home, logs
        self._project = f"slamcu-e2e-{os.getpid()}"
        self._road = f"{self._project}-road"
        port = port or free_port()
        self._version = version("slamcu-server")
        self._next_version = f"{self._version}-next"
        self._environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("SLAMCU_")},
            "SLAMCU_VERSION": self._version,
            "SLAMCU_PORT": str(port),
            "SLAMCU_SECRETS": str(home / "secrets"),
            "COMPOSE_PROJECT_NAME": self._project,
            "COMPOSE_FILE": str(root / "docker-compose.yml"),
        }
        self._compose = _compose_command()
        self._stack = ExitStack()
        self._cars: list[str] = []
        self.url = f"http://127.0.0.1:{port}"

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._logs.mkdir(parents=True, exist_ok=True)
            stack.callback(self._remove)
            _run([str(self._root / "scripts" / "secrets")], self._environment)
            # `up` waits for what depends on others; the rest gets healthy in its own time
            self._do("up", "--detach", "--no-build")
            self._wait_until_well()
            self._docker("network", "create", "--internal", self._road)
            self.mend_network()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    # --- commands and cars ------------------------------------------------------------------------------------------

    def command(self, *arguments: str | Path) -> str:
        """Run a command of `slamcu-server` in a container of its own and return its output."""
        shown = [f"{one.parent}:{one.parent}:ro" for one in arguments if isinstance(one, Path)]
        volumes = [word for one in shown for word in ("--volume", one)]
        return self._do("run", "--rm", "-T", "--no-deps", *volumes, "migrate", *(str(one) for one in arguments))

    def start_car(self, car: Car) -> None:
        """Let a car drive in a container that has the vehicle's image, its own folder, and no network but the road."""
        if os.geteuid() == 0:
            user = f"{_USER}:{_USER}"
            for path in (car.folder, *car.folder.iterdir()):
                os.chown(path, _USER, _USER)
        else:
            user = f"{os.geteuid()}:{os.getegid()}"
        name = f"{self._project}-{car.name}"
        self._cars.append(name)
        self._docker(
            "run", "--detach", "--init", "--name", name, "--network", self._road, "--user", user, "--read-only",
            "--cap-drop", "ALL", "--security-opt", "no-new-privileges", "--memory", "512m", "--tmpfs", "/tmp",  # noqa: S108
            "--env", f"SLAMCU_API_KEY_FILE={car.key_file}", "--env", "OMP_NUM_THREADS=1",
            "--volume", f"{car.folder}:{car.folder}", "--volume", f"{car.log.parent}:{car.log.parent}:ro",
            f"slamcu-vehicle:{self._version}", *car.arguments("http://slamcu:8000"),
        )  # fmt: skip

    def cars_under_way(self) -> int:
        """Return how many cars have not come to the end; raise SystemFaultError if one failed."""
        states = [one["State"] for one in self._inspect(self._cars)]
        for name, state in zip(self._cars, states, strict=True):
            if not state["Running"] and state["ExitCode"] != 0:
                said = self._docker("logs", "--tail", "5", name, merged=True).strip()
                raise SystemFaultError(f"{name} ended with {state['ExitCode']}: {said}")
        return sum(state["Running"] for state in states)

    # --- faults -----------------------------------------------------------------------------------------------------

    def kill(self, service: str) -> None:
        """Kill a service's processes behind the engine's back, so that its restart policy is what brings it back."""
        pid = self._inspect([self._container(service)])[0]["State"]["Pid"]
        self._docker(
            "run", "--rm", "--pid", "host", "--user", "0", "--network", "none", "--entrypoint", "/bin/sh",
            f"slamcu-proxy:{self._version}", "-c", f"kill -KILL {pid}",
        )  # fmt: skip

    def cut_network(self) -> None:
        """Take the proxy off the cars' network: what they send goes nowhere."""
        self._docker("network", "disconnect", self._road, self._container(_PROXY))

    def mend_network(self) -> None:
        """Put it on again."""
        self._docker("network", "connect", "--alias", "slamcu", self._road, self._container(_PROXY))

    def ailing(self) -> list[str]:
        """Return what does not run or is not healthy, as the engine sees it."""
        containers = self._containers()
        found = [f"{service}: there is no container" for service in (*SERVICES, _PROXY) if service not in containers]
        for service, state in containers.items():
            health = state.get("Health", {}).get("Status", "healthy")
            if service in (*SERVICES, _PROXY) and not (state["Running"] and health == "healthy"):
                found.append(f"{service}: {state['Status']}, {health}")
        return found

    # --- upgrade, backup, end ---------------------------------------------------------------------------------------

    def migrate_to_next(self) -> None:
        """Build the next release, an image with one more migration, and run its command."""
        self._build_next()
        self._environment = {**self._environment, "SLAMCU_VERSION": self._next_version}
        self.command("migrate")

    def upgrade(self, service: str) -> None:
        """Replace a service's container by one of the next release, and leave the others alone."""
        self._do("up", "--detach", "--no-build", "--no-deps", service)

    def back_up(self, path: Path) -> None:
        """Write a dump of the database."""
        with path.open("wb") as file:
            command = [*self._compose, "exec", "-T", DATABASE, "pg_dump", "--format=custom", "slamcu"]
            _run(command, self._environment, stdout=file)

    def destroy_and_restore(self, path: Path) -> None:
        """Stop all but the proxy, remove the database with its volume, and make a new one of the dump."""
        users = [service for service in SERVICES if service != DATABASE]
        self._do("stop", *users)
        self._do("rm", "--force", "--stop", DATABASE, "migrate")
        for container in self._docker("ps", "--all", "--quiet", "--filter", f"volume={self._volume}").split():
            self._docker("rm", "--force", container)
        self._docker("volume", "rm", self._volume)
        self._do("up", "--detach", "--no-build", "--no-deps", DATABASE)
        self._wait_until_well([DATABASE])
        with path.open("rb") as file:
            command = [*self._compose, "exec", "-T", DATABASE, "pg_restore", "--exit-on-error", "--dbname=slamcu"]
            _run(command, self._environment, stdin=file)
        self._do("start", *users)
        self._wait_until_well()

    def stop(self) -> list[str]:
        """Stop everything in order; return what had to be killed."""
        self._do("stop")
        return [service for service, state in self._containers().items() if state["ExitCode"] in _FORCED]

    # --- within -----------------------------------------------------------------------------------------------------

    @property
    def _volume(self) -> str:
        return f"{self._project}_database"

    def _build_next(self) -> None:
        name, text = next_release.migration()
        folder = self.home / "next-image"
        folder.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
        where = "/opt/slamcu/lib/python3.11/site-packages/slamcu_server/migrations/versions/"
        recipe = f"FROM slamcu-server:{self._version}\nCOPY {name} {where}\n"
        (folder / "Dockerfile").write_text(recipe, encoding="utf-8")
        self._docker("build", "--quiet", "--tag", f"slamcu-server:{self._next_version}", str(folder))
        for same in _SAME_IN_NEXT:
            self._docker("tag", f"slamcu-{same}:{self._version}", f"slamcu-{same}:{self._next_version}")

    def _wait_until_well(self, services: Sequence[str] | None = None) -> None:
        deadline = time.monotonic() + _START_TIMEOUT_S
        while found := [one for one in self.ailing() if services is None or one.split(":")[0] in services]:
            if time.monotonic() > deadline:
                raise SystemFaultError(f"not healthy after {_START_TIMEOUT_S:g} s: {'; '.join(found)}")
            time.sleep(_POLL_S)

    def _container(self, service: str) -> str:
        found = self._do("ps", "--quiet", service).split()
        if len(found) != 1:
            raise SystemFaultError(f"{service} has {len(found)} containers")
        return found[0]

    def _containers(self) -> dict[str, dict[str, Any]]:
        """Return the state of the project's containers by service."""
        label = f"label=com.docker.compose.project={self._project}"
        names = self._docker("ps", "--all", "--quiet", "--filter", label).split()
        return {
            one["Config"]["Labels"]["com.docker.compose.service"]: one["State"]
            for one in self._inspect(names)
            if one["Config"]["Labels"].get("com.docker.compose.oneoff", "False").lower() != "true"
        }

    def _inspect(self, names: Sequence[str]) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = json.loads(self._docker("inspect", *names)) if names else []
        return found

    def _remove(self) -> None:
        """Keep what the containers said, and remove them with all that belongs to them."""
        for name in self._cars:
            self._keep(f"{name.removeprefix(self._project + '-')}.log", ["docker", "logs", "--timestamps", name])
            self._keep(None, ["docker", "rm", "--force", "--volumes", name])
        for service in (*SERVICES, _PROXY, "migrate"):
            self._keep(f"{service}.log", [*self._compose, "logs", "--no-color", "--timestamps", service])
        self._keep("compose-ps.txt", [*self._compose, "ps", "--all"])
        self._keep("compose-down.txt", [*self._compose, "down", "--volumes", "--remove-orphans", "--timeout", "10"])
        self._keep(None, ["docker", "network", "rm", self._road])
        for name in ("server", *_SAME_IN_NEXT):
            self._keep(None, ["docker", "image", "rm", f"slamcu-{name}:{self._next_version}"])

    def _keep(self, name: str | None, command: Sequence[str]) -> None:
        """Run a command for what it says, whether it succeeds or not."""
        done = subprocess.run(  # noqa: S603  (our own commands)
            command, env=self._environment, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        if name is not None:
            (self._logs / name).write_bytes(done.stdout)

    def _do(self, *arguments: str) -> str:
        return _run([*self._compose, *arguments], self._environment)

    def _docker(self, *arguments: str, merged: bool = False) -> str:
        return _run(["docker", *arguments], self._environment, merged=merged)


def _compose_command() -> list[str]:
    found = subprocess.run(["docker", "compose", "version"], check=False, capture_output=True)  # noqa: S607
    return ["docker", "compose"] if found.returncode == 0 else ["docker-compose"]


def _run(
    command: Sequence[str],
    environment: Mapping[str, str],
    *,
    stdin: Any = subprocess.DEVNULL,
    stdout: Any = subprocess.PIPE,
    merged: bool = False,
) -> str:
    try:
        done = subprocess.run(  # noqa: S603  (our own commands)
            command,
            env=environment,
            stdin=stdin,
            stdout=stdout,
            stderr=subprocess.STDOUT if merged else subprocess.PIPE,
            check=False,
        )
    except FileNotFoundError:
        raise SystemFaultError(f"{command[0]} is not installed") from None
    if done.returncode != 0:
        said = (done.stderr or done.stdout or b"").decode(errors="replace").strip()
        raise SystemFaultError(f"{' '.join(command[:6])} … failed: {said[-1500:]}")
    return (done.stdout or b"").decode(errors="replace")
