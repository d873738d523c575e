"""How the command line programs answer Ctrl-C: at any moment, quietly, with exit code 130.

A program imports for half a second and more, and what runs in an import may swallow a KeyboardInterrupt or make another
error of it. So while a program imports nothing is raised: the process ends.

It stands in the core because all programs share it; nothing else of the core may import it.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType

INTERRUPTED = 130  # as shells say it: 128 and the number of SIGINT


def run(module: str) -> int:
    """Import a module, run its `main` and return the exit code: what that returned, or 130 after Ctrl-C.

    To be imported and called before anything else. A program that was started with Ctrl-C ignored, as the background
    jobs of a script are, goes on ignoring it.
    """
    with ends_at_once():
        main: Callable[[], int | None] = import_module(module).main
    try:
        return main() or 0
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        if _raises():
            signal.signal(signal.SIGINT, _end)  # for the rest, in which the interpreter ends


@contextmanager
def ends_at_once() -> Iterator[None]:
    """Let Ctrl-C end the process within the block, which has nothing to tidy up; does nothing in another thread."""
    if not _raises():
        yield
        return
    signal.signal(signal.SIGINT, _end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _raises() -> bool:
    """Whether Ctrl-C raises KeyboardInterrupt here: only in the main thread, which alone may say otherwise."""
    in_main = threading.current_thread() is threading.main_thread()
    return in_main and signal.getsignal(signal.SIGINT) is signal.default_int_handler


def _end(_number: int, _frame: FrameType | None) -> None:
    os._exit(INTERRUPTED)
