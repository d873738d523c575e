"""What the story is told about: a running system, its cars and its network, however they were started."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from slamcu_core.errors import SlamcuError

DATABASE = "database"
APIS = ("api-1", "api-2")
WORKERS = ("worker-1", "worker-2")
SERVICES = (DATABASE, *APIS, *WORKERS)


class SystemFaultError(SlamcuError):
    """The system does not do what the story needs."""


@dataclass(frozen=True, slots=True)
class Car:
    """One car of a fleet: its drive, and the folder with its key, its outbox and its result."""

    name: str
    log: Path
    folder: Path
    map_name: str
    pace: float
    seed: int

    @property
    def outbox(self) -> Path:
        """Where its reports wait, and what it knows about those that are gone."""
        return self.folder / "outbox.sqlite"

    @property
    def result(self) -> Path:
        """What it says of the map by itself."""
        return self.folder / "result.geojson"

    @property
    def key_file(self) -> Path:
        """Its key to the API."""
        return self.folder / "key"

    def arguments(self, url: str) -> list[str]:
        """Return the command line of `slamcu-vehicle`."""
        return [
            "drive", "--map-name", self.map_name, "--log", str(self.log), "--server", url, "--pace", str(self.pace),
            "--outbox", str(self.outbox), "--result", str(self.result), "--seed", str(self.seed), "--wait", "300",
        ]  # fmt: skip


class System(Protocol):
    """A database, two replicas of the API behind one address, two workers, and cars on a network of their own."""

    @property
    def url(self) -> str:
        """The address of the API for providers."""

    @property
    def home(self) -> Path:
        """A folder that cars and commands may be shown files of."""

    def command(self, *arguments: str | Path) -> str:
        """Run a command of `slamcu-server` on the database and return its output; a Path is a file it is to read.

        Raises SlamcuError if it fails.
        """

    def start_car(self, car: Car) -> None:
        """Let a car drive."""

    def cars_under_way(self) -> int:
        """Return how many cars have not come to the end; raise SystemFaultError if one failed."""

    def kill(self, service: str) -> None:
        """Kill a service as a crash would (SIGKILL); whoever looks after it starts it again."""

    def cut_network(self) -> None:
        """Take the cars' network away."""

    def mend_network(self) -> None:
        """Give it back."""

    def ailing(self) -> list[str]:
        """Return what does not run or is not healthy, in words."""

    def migrate_to_next(self) -> None:
        """Bring the schema to that of the next release, with its own command."""

    def upgrade(self, service: str) -> None:
        """Replace a service by its next release, in order."""

    def back_up(self, path: Path) -> None:
        """Write all that the database holds to a file."""

    def destroy_and_restore(self, path: Path) -> None:
        """Stop the system, throw the database away, make a new one of the backup, and start again."""

    def stop(self) -> list[str]:
        """Stop everything in order; return what did not end by itself within its ten seconds."""
