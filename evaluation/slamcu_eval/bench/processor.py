"""Processor time of processes, as the kernel counts it: unlike the clock, it does not run while others work."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Iterable


def seconds(pids: Iterable[int]) -> float:
    """Return the processor time that processes of this machine have used, to the ns; what has ended counts nothing.

    Threads that have ended count on with their process. Where POSIX's CPU-time clocks of other processes are not to be
    had everything counts nothing.
    """
    return sum(map(_seconds, pids))


def _seconds(pid: int) -> float:
    clock = ctypes.c_int()
    try:
        if ctypes.CDLL(None).clock_getcpuclockid(pid, ctypes.byref(clock)) != 0:
            return 0.0
        return time.clock_gettime(clock.value)
    except (OSError, AttributeError):  # ended in between, or a system without
        return 0.0
