"""Vehicles side by side, each in a process of its own."""

from __future__ import annotations

import os
import queue
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from functools import partial
from multiprocessing.queues import Queue

from slamcu_core.errors import SlamcuError
from slamcu_eval.copies import clean_copies, in_copies
from slamcu_eval.fleet.vehicle import VehicleJob, VehicleOutcome, drive_vehicle

Tell = Callable[[int, float], None]

_POLL_S = 0.1
_progress: Queue[tuple[int, float]] | None = None  # of a vehicle's process, set when it starts


class VehicleError(SlamcuError):
    """A vehicle of a fleet could not drive or report; the text says which one and why."""


def drive_fleet(
    jobs: Sequence[VehicleJob], *, processes: int | None = None, tell: Tell = lambda _vehicle, _share: None
) -> list[VehicleOutcome]:
    """Let vehicles drive in parallel and return their outcomes, in the order of the jobs.

    Parameters
    ----------
    processes : how many drive at the same time; by default as many as there are processors.
    tell : called in this process with the number of a vehicle and the share of its drive that is done.

    Raises VehicleError if one could not drive or report; the others are stopped then, as they are on Ctrl-C.
    """
    shares: Queue[tuple[int, float]] = clean_copies().Queue()
    count = min(processes or os.cpu_count() or 1, len(jobs))
    try:
        calls = [partial(_drive, index, job) for index, job in enumerate(jobs)]
        with in_copies(count, calls, _begin, (shares,)) as futures:
            waiting = set(futures)
            while waiting:
                done, waiting = wait(waiting, timeout=_POLL_S, return_when=FIRST_COMPLETED)
                _pass_on(shares, tell)
                for future in done:
                    future.result()
            _pass_on(shares, tell)
            return [future.result() for future in futures]
    finally:
        shares.close()


def _pass_on(shares: Queue[tuple[int, float]], tell: Tell) -> None:
    while True:
        try:
            tell(*shares.get_nowait())
        except queue.Empty:
            return


def _begin(shares: Queue[tuple[int, float]]) -> None:
    """Prepare a vehicle's process."""
    global _progress  # noqa: PLW0603  (a pool hands its processes state in no other way)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _progress = shares


def _drive(index: int, job: VehicleJob) -> VehicleOutcome:
    try:
        return drive_vehicle(job, partial(_tell, index))
    except (SlamcuError, OSError) as error:
        # In words, because not every error survives the way between processes.
        raise VehicleError(f"{job.drive}: {error}") from None


def _tell(index: int, share: float) -> None:
    if _progress is not None:
        _progress.put((index, share))
