"""PostgreSQL's own programs: where they are, as which user they run, and running them."""

from __future__ import annotations

import os
import pwd
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from slamcu_core.errors import SlamcuError

_PLACES = (
    "/usr/lib/postgresql/*/bin",  # Debian, Ubuntu: off PATH
    "/usr/pgsql-*/bin",  # Fedora, RHEL
    "/opt/homebrew/opt/postgresql@*/bin",
    "/usr/local/opt/postgresql@*/bin",
)
_INSTALL = "install it (Debian, Ubuntu: apt-get install postgresql-15-postgis-3; in the sources: make setup)"


class EmbeddedDatabaseError(SlamcuError):
    """The private database cluster cannot be had."""


@dataclass(frozen=True, slots=True)
class RunAs:
    """The system user that PostgreSQL runs as: this one, or for root, whom PostgreSQL refuses, another."""

    name: str
    uid: int
    gid: int
    drop: bool  # whether this process must change to it

    @classmethod
    def current(cls) -> RunAs:
        """Return this process's user, or `postgres` or `nobody` in place of root."""
        if os.geteuid() != 0:
            return cls(str(os.geteuid()), os.geteuid(), os.getegid(), drop=False)
        for name in ("postgres", "nobody"):  # a bare uid will not do: initdb asks for the user's name
            try:
                entry = pwd.getpwnam(name)
            except KeyError:
                continue
            return cls(name, entry.pw_uid, entry.pw_gid, drop=True)
        raise EmbeddedDatabaseError("PostgreSQL does not run as root, and there is neither a user postgres nor nobody")


@dataclass(frozen=True, slots=True)
class PostgresTools:
    """The programs of one PostgreSQL installation, run as `user`."""

    bin_dir: Path
    user: RunAs

    @classmethod
    def find(cls, user: RunAs, *, bin_dir: Path | None = None, major: str | None = None) -> PostgresTools:
        """Find an installation with PostGIS: in `bin_dir` or a usual place, of version `major` or the newest."""
        if bin_dir is not None:
            found = [bin_dir]
        else:
            found = sorted((p for place in _PLACES for p in Path("/").glob(place[1:])), key=_version, reverse=True)
            if on_path := shutil.which("initdb"):
                found.insert(0, Path(on_path).resolve().parent)
        installations = [path for path in found if (path / "initdb").exists() and (path / "pg_ctl").exists()]
        if not installations:
            raise EmbeddedDatabaseError(f"PostgreSQL with PostGIS is not found: {_INSTALL}, or set SLAMCU_DATABASE_URL")
        if major is not None:
            installations = [path for path in installations if _major(path) == major]
            if not installations:
                raise EmbeddedDatabaseError(
                    f"the data are PostgreSQL {major}'s, which is not installed: install it or move the data away"
                )
        for path in installations:
            if (_share(path) / "extension" / "postgis.control").exists():
                return cls(path, user)
        raise EmbeddedDatabaseError(f"PostgreSQL is here without PostGIS: {_INSTALL}, or set SLAMCU_DATABASE_URL")

    def run(
        self, program: str, *arguments: str, cwd: Path = Path("/"), timeout: float = 60.0
    ) -> subprocess.CompletedProcess[str]:
        """Run one of the programs as the cluster's user, in a directory open to it, and return what it said."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PG")}
        identity = {"user": self.user.uid, "group": self.user.gid, "extra_groups": []} if self.user.drop else {}
        result: subprocess.CompletedProcess[str] = subprocess.run(  # noqa: S603  (no shell; the arguments are ours)
            [str(self.bin_dir / program), *arguments],
            check=False,
            cwd=cwd,
            env=environment | {"LC_ALL": "C"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=timeout,
            start_new_session=True,  # Ctrl-C in a terminal is for us, and not for what we start
            **identity,  # type: ignore[call-overload]  # mypy cannot match **kwargs to the overloads
        )
        return result


def _version(bin_dir: Path) -> tuple[int, ...]:
    return tuple(int(n) for n in re.findall(r"\d+", str(bin_dir)))


def _output(program: Path, *arguments: str) -> str:
    try:
        result = subprocess.run([program, *arguments], check=False, capture_output=True, text=True, timeout=10)  # noqa: S603
    except OSError:
        return ""
    return result.stdout.strip()


def _major(bin_dir: Path) -> str:
    version = re.search(r"\d+", _output(bin_dir / "pg_ctl", "--version"))
    return version.group() if version else ""


def _share(bin_dir: Path) -> Path:
    return Path(_output(bin_dir / "pg_config", "--sharedir") or f"/usr/share/postgresql/{_major(bin_dir)}")
