"""The processor time of another process is what that process itself is told, with the threads that have ended."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest

from slamcu_eval.bench import processor

_WORKS_WHEN_TOLD = """if True:
    import sys, threading, time

    for _ in sys.stdin:
        thread = threading.Thread(target=sum, args=(range(100_000),))
        thread.start()
        thread.join()
        print(time.process_time(), flush=True)
"""


@pytest.fixture
def worker() -> Iterator[subprocess.Popen[str]]:
    """A process that works in a thread for each line it is sent, and says what it has used since it began."""
    command = (sys.executable, "-c", _WORKS_WHEN_TOLD)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


def _work(worker: subprocess.Popen[str]) -> float:
    assert worker.stdin is not None
    assert worker.stdout is not None
    worker.stdin.write("on\n")
    worker.stdin.flush()
    return float(worker.stdout.readline())


def test_what_is_read_lies_between_what_the_process_reads_before_and_after(worker: subprocess.Popen[str]) -> None:
    for _ in range(20):
        before = _work(worker)
        read = processor.seconds([worker.pid])
        assert before < read < _work(worker)


def test_what_several_have_used_is_added_and_what_has_ended_counts_nothing(worker: subprocess.Popen[str]) -> None:
    before = _work(worker)
    assert processor.seconds([worker.pid] * 2) > 2.0 * before
    worker.kill()
    worker.wait()
    assert processor.seconds([worker.pid]) == 0.0
