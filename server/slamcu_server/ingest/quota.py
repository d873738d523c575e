"""How much a vehicle may report: a bucket per account that fills steadily, for a backlog and against a flood.

A request is refused while the bucket is empty, and its content is charged once it has been read: what a batch holds is
known only then. A batch may therefore overdraw the bucket, by no more than the largest body.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable

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

    def wait_s(self, account_id: int) -> float:
        """Return how long an account has to wait; 0 if it may report."""
        if not self._rate:
            return 0.0
        left = self._left(account_id)
        return 0.0 if left > 0.0 else (1.0 - left) / self._rate

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
