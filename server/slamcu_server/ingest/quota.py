"""How much a vehicle may report: a bucket per account that fills steadily, for a backlog and against a flood.

A request is refused while the bucket is empty. What a batch holds is known only once it has been read, so the most that
its bytes can hold is kept back until then, and what could not be read costs that much. A batch may overdraw the bucket,
by no more than the largest body, however many arrive at a time.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PASS_BYTES = 20
"""The least that a pass takes on the wire (the densest that is read takes 36 bytes without a map reference)."""

_UNDER_WAY_S = 1.0  # to wait for what others of the account hold
_ACCOUNTS = 100_000
"""Accounts that are remembered; one that is forgotten starts with a full bucket."""


class Quota:
    """The buckets of one process.

    Parameters
    ----------
    rate : passes a second that flow in; 0: no limit.
    burst : passes that a bucket holds.
    clock : seconds.
    """

    def __init__(self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._buckets: OrderedDict[int, tuple[float, float]] = OrderedDict()  # left, at
        self._held: dict[int, float] = {}

    def wait_s(self, account_id: int) -> float:
        """Return how long an account has to wait; 0 if it may report."""
        if not self._rate:
            return 0.0
        left = self._left(account_id)
        if left <= 0.0:
            return (1.0 - left) / self._rate
        return 0.0 if left > self._held.get(account_id, 0.0) else _UNDER_WAY_S

    @contextmanager
    def holding(self, account_id: int, passes: float) -> Iterator[None]:
        """Keep back what a batch may hold at most, while it is read; charge it before this ends."""
        self._held[account_id] = self._held.get(account_id, 0.0) + passes
        try:
            yield
        finally:
            self._held[account_id] -= passes
            if self._held[account_id] <= 0.0:
                del self._held[account_id]

    def charge(self, account_id: int, passes: int) -> None:
        """Take what an account has reported."""
        if not self._rate:
            return
        self._buckets[account_id] = self._left(account_id) - passes, self._clock()
        self._buckets.move_to_end(account_id)
        while len(self._buckets) > _ACCOUNTS:
            self._buckets.popitem(last=False)

    def _left(self, account_id: int) -> float:
        left, at = self._buckets.get(account_id, (self._burst, self._clock()))
        return min(left + (self._clock() - at) * self._rate, self._burst)
