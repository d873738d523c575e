"""What all tests share: examples of property tests have no deadline, for the machine may be busy."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

settings.register_profile("slamcu", deadline=None)
settings.load_profile("slamcu")


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Let programs that are started take Ctrl-C: a shell's background jobs inherit that it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
