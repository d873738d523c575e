from __future__ import annotations

import sqlite3
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from slamcu_client import Outbox, OutboxError, ReportPolicy
from slamcu_client.reporter import Reporter
from slamcu_core.reports import (
    DetectionStatus,
    Health,
    MapReference,
    MeasuredPosition,
    PassReport,
    ReportMessage,
)
from slamcu_core.sensoris import MAX_PASS_WEIGHT, decode_message

START = datetime(2026, 5, 1, 8, tzinfo=UTC)
TEMPLATE = ReportMessage("s", 1, sensor_model="cam", software_version="test")


def at(t: float) -> datetime:
    return START + timedelta(seconds=t)


def one(object_id: int, t: float = 1.0, variance: float = 0.04) -> PassReport:
    return PassReport(
        at(t - 1.0),
        at(t),
        DetectionStatus.EXPECTED_AND_DETECTED,
        2.0,
        0.0,
        reference=MapReference(0, object_id),
        position=MeasuredPosition(2.1, 48.9, (variance, 0.0, variance)),
        frames_detected=5,
    )


def stored(outbox: Outbox) -> list[tuple[bool, list[int]]]:
    messages = [decode_message(message.body) for message in outbox.pending(10_000)]
    return [
        (message.health.trusted, [report.reference.object_id for report in message.passes if report.reference])
        for message in messages
    ]


@pytest.fixture
def outbox(tmp_path: Path):
    with Outbox(tmp_path / "o") as box:
        yield box


def test_passes_are_gathered_for_an_interval_of_drive_time(outbox: Outbox) -> None:
    reporter = Reporter(outbox, TEMPLATE, ReportPolicy(interval_s=10.0))
    for t in range(1, 31):
        reporter.tick(float(t), at(t - 1))
        reporter.add([one(t, t)], Health(), float(t), at(t))
    reporter.finish([one(31, 31)], Health(), at(31), 30.0)
    assert stored(outbox) == [
        (True, list(range(1, 11))),
        (True, list(range(11, 21))),
        (True, list(range(21, 32))),
    ]
    assert outbox.session("s").closed


def test_what_a_lost_filter_saw_is_flagged_and_does_not_taint_the_rest(outbox: Outbox) -> None:
    reporter = Reporter(outbox, TEMPLATE, ReportPolicy())
    for t, trusted in enumerate([True, True, False, False, True], start=1):
        reporter.add([one(t, t)], Health(trusted=trusted), float(t), at(t))
    reporter.finish([], Health(), at(6), 30.0)
    assert stored(outbox) == [(True, [1, 2]), (False, [3, 4]), (True, [5])]


def test_passes_of_one_instant_are_stored_together_or_not_at_all(outbox: Outbox) -> None:
    """Or else a restart, which goes on after the last stored instant, would lose the rest of them."""
    reporter = Reporter(outbox, TEMPLATE, ReportPolicy(interval_s=0.0, max_passes=2))
    reporter.tick(5.0, at(4))
    reporter.add([one(1), one(2), one(3)], Health(), 5.0, at(5))
    reporter.add([one(4)], Health(), 5.0, at(5))
    assert reporter.wait_stored(30.0)
    assert stored(outbox) == []
    reporter.tick(5.1, at(5))
    assert reporter.wait_stored(30.0)
    assert stored(outbox) == [(True, [1, 2]), (True, [3, 4])]
    assert outbox.session("s").reported_until == at(5)
    reporter.abandon(30.0)


def test_one_pass_that_no_server_would_take_does_not_cost_the_others(outbox: Outbox) -> None:
    reporter = Reporter(outbox, TEMPLATE, ReportPolicy())
    reporter.add([one(1), one(2, variance=-1.0), one(3)], Health(), 1.0, at(1))
    reporter.finish([], Health(), at(2), 30.0)
    assert stored(outbox) == [(True, [1, 3])]
    assert (reporter.reported, reporter.unusable) == (2, 1)


def test_a_pass_that_weighs_more_than_a_receiver_takes_is_reported(outbox: Outbox) -> None:
    """So does a car that waits for minutes in view of a sign."""
    reporter = Reporter(outbox, TEMPLATE, ReportPolicy())
    reporter.add([replace(one(1), weight_for=1844.0, weight_against=845.0)], Health(), 1.0, at(1))
    reporter.finish([], Health(), at(2), 30.0)
    (report,) = decode_message(outbox.pending(1)[0].body).passes
    assert (report.weight_for, report.weight_against) == (MAX_PASS_WEIGHT, 1.0)
    assert (reporter.reported, reporter.unusable) == (1, 0)


def test_memory_is_bounded_while_the_disk_takes_nothing(outbox: Outbox) -> None:
    hang = sqlite3.connect(outbox.path, isolation_level=None)
    hang.execute("BEGIN IMMEDIATE")
    reporter = Reporter(outbox, TEMPLATE, ReportPolicy(interval_s=0.0, max_waiting_passes=10))
    for t in range(1, 101):
        reporter.add([one(t, t)], Health(), float(t), at(t))
        reporter.tick(t + 0.5, at(t))
    hang.execute("ROLLBACK")
    hang.close()
    reporter.finish([], Health(), at(101), 30.0)
    kept = [object_id for _, ids in stored(outbox) for object_id in ids]
    assert reporter.dropped == 100 - len(kept)
    assert len(kept) == reporter.reported <= 11
    assert kept == sorted(kept)
    assert kept[-1] == 100, "the oldest gave way"


def test_a_disk_that_never_comes_back_is_told(outbox: Outbox) -> None:
    hang = sqlite3.connect(outbox.path, isolation_level=None)
    hang.execute("BEGIN IMMEDIATE")
    reporter = Reporter(outbox, TEMPLATE, ReportPolicy())
    reporter.add([one(1), one(2)], Health(), 1.0, at(1))
    with pytest.raises(OutboxError, match="2 passes could not be stored"):
        reporter.finish([], Health(), at(2), 0.05)
    hang.execute("ROLLBACK")
    hang.close()
