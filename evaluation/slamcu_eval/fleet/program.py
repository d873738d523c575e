"""A program of ours as a process: started, stopped in order, or killed as a crash would."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from slamcu_core.errors import SlamcuError

_STOP_TIMEOUT_S = 20.0


class ProgramError(SlamcuError):
    """A program does not do what it should; the text ends with what it said."""


class Program:
    """One `slamcu-server` process at a time.

    It gets a session of its own, so that Ctrl-C in a terminal reaches only the one who started it, and is stopped in
    order by that one.

    Parameters
    ----------
    arguments : of `slamcu-server`; the first one names it in errors.
    environment : the whole of it.
    log : file that its output is appended to.
    """

    def __init__(self, arguments: Sequence[str], environment: Mapping[str, str], log: Path) -> None:
        self._arguments, self._environment, self._log = tuple(arguments), environment, log
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int:
        """Its process id; raises ProgramError if it is not running."""
        return self._running().pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process is not None and self._process.poll() is None

    def start(self) -> None:
        """Start it; raise ProgramError if it runs already."""
        if self.alive:
            raise ProgramError(f"the {self._arguments[0]} process runs already")
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(  # noqa: S603  (our own program)
                server_command(*self._arguments),
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def stop(self, timeout_s: float = _STOP_TIMEOUT_S) -> int:
        """Stop it in order, or kill it if that takes too long; return its status, 0 too if it was not running."""
        process, self._process = self._process, None
        if process is None:
            return 0
        process.terminate()
        try:
            return process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait()

    def kill(self) -> None:
        """Kill it with SIGKILL."""
        process, self._process = self._running(), None
        process.kill()
        process.wait()

    def wait(self) -> None:
        """Wait until it ends by itself."""
        self._running().wait()

    def check(self) -> None:
        """Raise ProgramError if it is not running."""
        self._running()

    def last_words(self) -> str:
        """Return the last line that it wrote."""
        text = self._log.read_text(encoding="utf-8", errors="replace") if self._log.exists() else ""
        lines = [line.strip() for line in text.split("\n") if line.strip()]
        return lines[-1] if lines else "it said nothing"

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            raise ProgramError(f"the {self._arguments[0]} process is not running: {self.last_words()}")
        return self._process


def run_server_command(arguments: Sequence[str], environment: Mapping[str, str]) -> str:
    """Run a command of `slamcu-server` to its end and return its output; raise ProgramError if it fails."""
    done = subprocess.run(  # noqa: S603  (our own program)
        server_command(*arguments),
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        said = done.stderr.strip().rsplit("\n", 1)[-1]
        raise ProgramError(f"slamcu-server {arguments[0]} failed: {said or 'no message'}")
    return done.stdout


def server_command(*arguments: str) -> list[str]:
    """Return the command line of `slamcu-server` in this very environment."""
    return [sys.executable, "-m", "slamcu_server", *arguments]
