"""Processes of their own for drives: copies of one clean process that has imported what they need, once.

A copy of the process that asks could hang: it has threads (the progress bar is one) that may hold locks. Fresh
interpreters, one for each drive's process, spent more time on importing than a short drive takes.
"""

from __future__ import annotations

from multiprocessing import get_context
from multiprocessing.context import ForkServerContext


def clean_copies() -> ForkServerContext:
    """Return the context to make pools of processes in."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["slamcu_eval.ablation", "slamcu_eval.fleet"])
    return context
