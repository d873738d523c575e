"""Processes of their own for drives: copies of one clean process that has imported what they need, once.

A copy of the process that asks could hang: it has threads (the progress bar is one) that may hold locks. Fresh
interpreters, one for each drive's process, spent more time on importing than a short drive takes.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, forkserver, get_context
from multiprocessing.context import ForkServerContext
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")
Handler = Callable[[int, FrameType | None], object] | signal.Handlers


def clean_copies() -> ForkServerContext:
    """Return the context to make pools of processes in; none of them minds Ctrl-C, which is for the one who asks."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["slamcu_eval.ablation", "slamcu_eval.fleet"])
    with _ctrl_c(signal.SIG_IGN):
        forkserver.ensure_running()  # in which it is ignored from the start, as in its copies
    return context


@contextmanager
def in_copies(
    processes: int,
    calls: Iterable[Callable[[], T]],
    initializer: Callable[..., object] | None = None,
    initargs: tuple[Any, ...] = (),
) -> Iterator[list[Future[T]]]:
    """Begin calls in such processes, and give their futures; if the block fails or is interrupted, all are stopped."""
    pool = ProcessPoolExecutor(processes, mp_context=clean_copies(), initializer=initializer, initargs=initargs)
    try:
        with _ctrl_c_held_back():  # a process that is interrupted in its making would be left to itself
            futures = [pool.submit(call) for call in calls]
        yield futures
    except BaseException:
        for process in active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    came: list[int] = []
    try:
        with _ctrl_c(lambda number, _frame: came.append(number)):
            yield
    finally:
        if came:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def _ctrl_c(handler: Handler) -> Iterator[None]:
    """Answer Ctrl-C otherwise within the block; in another thread than the main one it is not ours to answer."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
