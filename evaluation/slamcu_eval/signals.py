"""Signals that ask a process to end: as an exception that unwinds what it has begun, and where none can be borne.

In another thread than the main one signals cannot be set, and all of this leaves them as they are.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

Handler = Callable[[int, FrameType | None], object] | signal.Handlers


@contextmanager
def signals_as_exit() -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the stack, so that what was started is stopped."""

    def leave(number: int, _: FrameType | None) -> None:
        raise SystemExit(128 + number)

    with _answered(signal.SIGTERM, leave), _answered(signal.SIGHUP, leave):
        yield


@contextmanager
def ctrl_c_held_back() -> Iterator[None]:
    """Hold Ctrl-C back until the end of the block, which would not bear an interruption anywhere."""
    came: list[int] = []
    try:
        with _answered(signal.SIGINT, lambda number, _frame: came.append(number)):
            yield
    finally:
        if came:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def ctrl_c_ignored() -> Iterator[None]:
    """Ignore Ctrl-C within the block, and in the processes that it starts."""
    with _answered(signal.SIGINT, signal.SIG_IGN):
        yield


@contextmanager
def _answered(number: signal.Signals, handler: Handler) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)
