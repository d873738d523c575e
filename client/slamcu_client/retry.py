"""Whether to send again after a failure, and when: one pure function."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import NamedTuple

import numpy as np

from slamcu_client.errors import Fault


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """How patient the uploader is."""

    first_wait_s: float = 1.0  # doubled with each failure in a row
    longest_wait_s: float = 300.0  # cap of the doubling
    longest_retry_after_s: float = 3600.0  # cap of what a server may ask for, against a wrong clock


@dataclass(frozen=True, slots=True)
class Failure:
    """What went wrong with one attempt: either a fault on the way or an answer that is no success."""

    fault: Fault | None = None
    status: int | None = None
    retry_after: str | None = None  # as in the header: seconds or an HTTP date
    own: bool = False  # the answer is a problem document of the server itself


class RetryDecision(NamedTuple):
    """Whether to send the same bytes again, and after how many seconds."""

    retriable: bool
    wait_s: float


SAYS_AGAIN = frozenset({408, 425, 429})
"""The statuses of the 4xx with which a server asks for the same request later."""


def retry_decision(
    failure: Failure,
    attempt: int,
    *,
    rng: np.random.Generator,
    now: datetime,
    policy: RetryPolicy = RetryPolicy(),
) -> RetryDecision:
    """Decide whether an attempt that failed is worth repeating.

    Everything is but a 4xx of the server itself: a hotspot or proxy in front of it may answer with any status, and is
    left behind sooner or later. The wait doubles from `policy.first_wait_s` to `policy.longest_wait_s` with a jitter of
    half of it; a Retry-After header is a lower bound (with 10 % of jitter on top, so that a fleet does not come back at
    one instant).

    Parameters
    ----------
    failure : what happened.
    attempt : how many attempts failed in a row, counted from 1.
    rng : the source of the jitter.
    now : the present, for a Retry-After that is a date.
    """
    status = failure.status
    if failure.own and status is not None and 400 <= status < 500 and status not in SAYS_AGAIN:
        return RetryDecision(False, 0.0)
    doublings = min(max(attempt - 1, 0), 62)
    backoff = min(policy.first_wait_s * 2.0**doublings, policy.longest_wait_s)
    wait = backoff * float(rng.uniform(0.5, 1.0))
    asked = _retry_after(failure.retry_after, now)
    if asked is not None:
        wait = max(wait, min(asked, policy.longest_retry_after_s) * float(rng.uniform(1.0, 1.1)))
    return RetryDecision(True, wait)


def _retry_after(header: str | None, now: datetime) -> float | None:
    """Read a Retry-After header; None if there is none or it cannot be read."""
    if header is None:
        return None
    text = header.strip()
    if text.isascii() and text.isdigit():
        return float(text[:12])
    try:
        when = parsedate_to_datetime(text)
        when = when if when.tzinfo else when.replace(tzinfo=UTC)
        return max((when - now).total_seconds(), 0.0)
    except (ValueError, OverflowError):  # no date, or one with an offset of millions of years
        return None
