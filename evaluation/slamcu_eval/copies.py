"""Processes of their own for drives: copies of one clean process that has imported what they need, once.

A copy of the process that asks could hang: it has threads (the progress bar is one) that may hold locks. Fresh
interpreters, one for each drive's process, spent more time on importing than a short drive takes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import active_children, forkserver, get_context
from multiprocessing.context import ForkServerContext
from typing import Any, TypeVar

from slamcu_eval.signals import ctrl_c_held_back, ctrl_c_ignored

T = TypeVar("T")


def clean_copies() -> ForkServerContext:
    """Return the context to make pools of processes in; none of them minds Ctrl-C, which is for the one who asks."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["slamcu_eval.ablation", "slamcu_eval.fleet"])
    with ctrl_c_ignored():
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
        with ctrl_c_held_back():  # a process that is interrupted in its making would be left to itself
            futures = [pool.submit(call) for call in calls]
        yield futures
    except BaseException:
        for process in active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def run_all(processes: int, calls: Iterable[Callable[[], T]], done: Callable[[], None]) -> list[T]:
    """Return what calls in such processes return, in order; `done` is called after each."""
    with in_copies(processes, calls) as futures:
        for future in as_completed(futures):
            future.result()
            done()
        return [future.result() for future in futures]
