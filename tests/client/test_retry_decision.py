from __future__ import annotations

from datetime import UTC, datetime, timedelta
from email.utils import format_datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_client import RetryPolicy
from slamcu_client.errors import Fault
from slamcu_client.retry import Failure, RetryDecision, retry_decision

NOW = datetime(2026, 5, 1, 8, tzinfo=UTC)


def decide(failure: Failure, attempt: int = 1, seed: int = 0, policy: RetryPolicy | None = None) -> RetryDecision:
    return retry_decision(failure, attempt, rng=np.random.default_rng(seed), now=NOW, policy=policy or RetryPolicy())


@pytest.mark.parametrize(
    "failure",
    [
        *(Failure(fault=fault) for fault in Fault),
        *(Failure(status=s) for s in (200, 302, 408, 425, 429, 500, 502, 503, 504)),
        *(Failure(status=s, own=True) for s in (408, 425, 429, 500, 503)),
    ],
)
def test_what_may_pass_is_tried_again(failure: Failure) -> None:
    assert decide(failure).retriable


@pytest.mark.parametrize("status", [400, 401, 403, 404, 405, 409, 410, 413, 415, 422, 451])
def test_what_the_server_will_never_take_is_not_but_a_middleman_is_asked_again(status: int) -> None:
    assert decide(Failure(status=status, own=True)) == (False, 0.0)
    assert decide(Failure(status=status)).retriable
    assert 0.5 <= decide(Failure(status=status)).wait_s <= 1.0


@given(st.integers(1, 10_000), st.integers(0, 2**32))
def test_waits_grow_within_their_bounds(attempt: int, seed: int) -> None:
    wait = decide(Failure(fault=Fault.UNREACHABLE), attempt, seed).wait_s
    nominal = min(2.0 ** min(attempt - 1, 62), 300.0)
    assert nominal / 2 <= wait <= nominal


def test_waits_differ_from_car_to_car() -> None:
    waits = {decide(Failure(status=503), 5, seed).wait_s for seed in range(20)}
    assert len(waits) == 20


@pytest.mark.parametrize(
    ("header", "at_least", "at_most"),
    [
        ("120", 120.0, 132.0),
        (" 7 ", 7.0, 7.7),
        (format_datetime(NOW + timedelta(seconds=90), usegmt=True), 90.0, 99.0),
        ("Fri, 01 May 2026 08:01:30 -0000", 90.0, 99.0),
        (format_datetime(NOW - timedelta(hours=1), usegmt=True), 0.5, 1.0),  # past: the usual wait
        ("999999999999999999999999", 3600.0, 3960.0),  # no wrong clock may silence a car
        ("soon", 0.5, 1.0),
        ("Mon, 01 Jan 2024 00:00:00 +99999999999999", 0.5, 1.0),  # an offset that no date can have
        ("Mon, 01 Jan 0000 00:00:00 GMT", 0.5, 1.0),
        ("Mon, 99999999999999999999 Jan 1", 0.5, 1.0),
        ("-5", 0.5, 1.0),
        ("", 0.5, 1.0),
        ("²", 0.5, 1.0),  # a digit to Python, not to HTTP
    ],
)
@pytest.mark.parametrize("status", [429, 503])
def test_retry_after_is_a_lower_bound(status: int, header: str, at_least: float, at_most: float) -> None:
    decision = decide(Failure(status=status, retry_after=header))
    assert decision.retriable
    assert at_least <= decision.wait_s <= at_most


@given(st.text() | st.from_regex(r"(Mon, )?\d+ [A-Z][a-z]{2} \d+ \d+:\d+(:\d+)? ([+-]\d+|GMT)", fullmatch=True))
def test_no_retry_after_is_too_odd(header: str) -> None:
    assert 0.5 <= decide(Failure(status=503, retry_after=header)).wait_s <= 3960.0


def test_backoff_longer_than_retry_after_stands() -> None:
    assert decide(Failure(status=503, retry_after="1"), attempt=9).wait_s >= 128.0
