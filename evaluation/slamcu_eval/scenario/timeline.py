"""What happened when."""

from __future__ import annotations

import time
from collections.abc import Callable


class Timeline:
    """Tell what happens, with the seconds since the beginning, as it happens.

    Parameters
    ----------
    say : takes a line.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._begun = say, time.monotonic()
        self.lines: list[str] = []

    def __call__(self, text: str) -> None:
        """Tell one thing."""
        line = f"{time.monotonic() - self._begun:7.1f} s  {text}"
        self.lines.append(line)
        self._say(line)
