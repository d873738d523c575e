"""What `slamcu-vehicle` says: results on standard output, remarks on standard error. Neither may cost a report."""

from __future__ import annotations

import os
import sys
from typing import TextIO


class Console:
    """Writes lines as long as somebody takes them; what cannot be written is let go and remembered.

    A reader that has seen enough (`slamcu-vehicle … | head -1`) is no failure; a disk that is full is one.
    """

    def __init__(self) -> None:
        self.failure: OSError | None = None  # of standard output

    def tell(self, text: str) -> None:
        """Write a line of the result."""
        try:
            _write(sys.stdout, text)
        except BrokenPipeError:
            _silence(sys.stdout)
        except OSError as error:
            self.failure = error
            _silence(sys.stdout)

    def say(self, message: str) -> None:
        """Write a remark, or what went wrong."""
        try:
            _write(sys.stderr, f"slamcu-vehicle: {message}")
        except OSError:
            _silence(sys.stderr)


def _write(stream: TextIO | None, text: str) -> None:
    if stream is not None:  # closed by whoever started the command
        stream.write(f"{text}\n")
        stream.flush()


def _silence(stream: TextIO) -> None:
    """Let a stream write into nothing, also what it still holds: it would fail again when the process ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
