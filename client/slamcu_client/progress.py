"""A progress bar for terminals: by bytes of a file, on standard error, standard library only."""

from __future__ import annotations

import shutil
import sys
import time
from types import TracebackType
from typing import Self, TextIO

_REDRAW_S = 0.1


class ProgressBar:
    """Show how far a job has come; silent where the stream is no terminal.

    Parameters
    ----------
    label : what is being done.
    total : the measure of the whole, such as the bytes of a file.
    stream : where to draw; standard error unless given.
    """

    def __init__(self, label: str, total: int, stream: TextIO | None = None) -> None:
        self._label, self._total = label, max(total, 1)
        self._stream = sys.stderr if stream is None else stream
        self._shown = self._stream is not None and self._stream.isatty()  # None: closed by whoever started us
        self._start = time.monotonic()
        self._drawn_at = -1.0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shown and self._drawn_at >= 0.0:
            self._stream.write("\r\x1b[2K")  # the summary or the error takes the line
            self._stream.flush()

    def update(self, done: int, note: str = "") -> None:
        """Tell that `done` of the whole is done; draws at most ten times a second."""
        now = time.monotonic()
        if not self._shown or now - self._drawn_at < _REDRAW_S:
            return
        self._drawn_at = now
        share = min(max(done / self._total, 0.0), 1.0)
        elapsed = now - self._start
        left = f"{elapsed * (1.0 - share) / share:4.0f} s left" if share > 0.02 else ""
        columns = shutil.get_terminal_size().columns
        width = max(min(40, columns - len(self._label) - len(note) - 24), 10)
        full = round(width * share)
        line = f"{self._label} [{'#' * full}{'.' * (width - full)}] {share:4.0%} {left}  {note}"
        self._stream.write("\r\x1b[2K" + line[: columns - 1])
        self._stream.flush()
