"""What all tests share: no deadlines, for the machine may be busy, and a place for databases that waits for no disk."""

from __future__ import annotations

import contextlib
import fcntl
import multiprocessing.util
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("slamcu", deadline=None)
settings.load_profile("slamcu")

_MEMORY = Path("/dev/shm")
_PREFIX, _LOCK = "slamcu-tests-", "lock"
_ROOM_BYTES = 4 * 2**30  # several times what all workers together have there at any time


@pytest.fixture(scope="session", autouse=True)
def scratch_in_memory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let every cluster that is made for a test, here or in a process, lie in memory where there is room for it.

    Tests kill processes, which loses nothing that was handed to the system; none cuts the power. Making and dropping
    a database takes three to four times as long on a disk. pytest's own folders, which outlive the run, stay there.
    """
    # both settled before the default changes: they outlive this
    tmp_path_factory.getbasetemp()
    multiprocessing.util.get_temp_dir()
    try:
        _sweep()
        free = shutil.disk_usage(_MEMORY).free
        directory = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=_MEMORY)) if free > _ROOM_BYTES else None
    except OSError:
        directory = None
    if directory is None:
        yield
        return
    with (directory / "new").open("w") as mine:
        fcntl.flock(mine, fcntl.LOCK_EX)  # ends with this process, however it ends
        (directory / "new").rename(directory / _LOCK)
        directory.chmod(0o711)  # PostgreSQL does not run as root, and must be able to get to its directories
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("TMPDIR", str(directory))
            patch.setattr(tempfile, "tempdir", None)
            yield
            shutil.rmtree(directory, ignore_errors=True)


def _sweep() -> None:
    """Free the memory of runs that were killed; a server whose files are gone ends by itself within a minute."""
    for lock in _MEMORY.glob(f"{_PREFIX}*/{_LOCK}"):
        with contextlib.suppress(OSError), lock.open() as held:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(lock.parent, ignore_errors=True)


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Let programs that are started take Ctrl-C: a shell's background jobs inherit that it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def interrupted(ctrl_c: None, tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Return a function that runs a program and all it starts until Ctrl-C comes, so many seconds after its beginning.

    Its beginning is when the interpreter is up and has come to the program's own first module: what a busy machine
    takes to get there is nothing that the program could answer for. What it says goes into a file: a pipe would be full
    of imports, and keep it from going on.
    """
    told = tmp_path / "told-on-stderr"

    def run(
        program: str, *arguments: str, after_s: float, environment: Mapping[str, str] = os.environ
    ) -> subprocess.CompletedProcess[str]:
        with told.open("w") as stderr:
            process = subprocess.Popen(
                [Path(sys.executable).with_name(program), *arguments],
                env={**environment, "PYTHONPROFILEIMPORTTIME": "1"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=stderr,
                text=True,
                start_new_session=True,
            )
        try:
            while "slamcu_core.program" not in told.read_text():
                assert process.poll() is None, told.read_text()
                time.sleep(0.005)
            time.sleep(after_s)
            os.killpg(process.pid, signal.SIGINT)
            said, _ = process.communicate(timeout=60)  # also until nothing is left that it has started
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        lines = [line for line in told.read_text().splitlines() if not line.startswith("import time:")]
        return subprocess.CompletedProcess(process.args, process.returncode, said, "\n".join(lines))

    return run
