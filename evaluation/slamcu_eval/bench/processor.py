"""Processor time of processes, as the kernel counts it: unlike the clock, it does not run while others work."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

_USER, _SYSTEM = 11, 12  # fields of /proc/PID/stat after the name


def seconds(pids: Iterable[int]) -> float:
    """Return the processor time that processes of this machine have used; what has ended counts nothing.

    Where there is no /proc everything counts nothing.
    """
    return sum(map(_seconds, pids))


def _seconds(pid: int) -> float:
    try:
        told = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0.0
    fields = told.rpartition(")")[2].split()
    return (int(fields[_USER]) + int(fields[_SYSTEM])) / os.sysconf("SC_CLK_TCK")
