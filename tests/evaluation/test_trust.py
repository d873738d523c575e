"""Whether the filter knew when it was lost: which reports are wrong, and what counts as a warning in time."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from slamcu_core.reports import DetectionStatus, MapReference, MeasuredPosition, PassReport
from slamcu_eval.score import Fact
from slamcu_eval.trust import ToldPass, Trust, judge, lost_at, trust_figures

START = datetime(2026, 5, 1, 8, tzinfo=UTC)
FACTS = [Fact("normal", (0.0, 0.0), object_id=1), Fact("deleted", (50.0, 0.0), object_id=2), Fact("new", (100.0, 0.0))]
SEEN, MISSED, BLOCKED = (2.0, 0.3), (0.3, 2.0), (0.0, 0.0)  # weights for and against
FOUND, FAINT = SEEN, (0.3, 0.5)


def _report(weights: tuple[float, float], *, object_id: int | None = None, x: float | None = None) -> PassReport:
    return PassReport(
        started_at=START,
        ended_at=START + timedelta(seconds=7.5),
        status=DetectionStatus.EXPECTED_AND_DETECTED,
        weight_for=weights[0],
        weight_against=weights[1],
        reference=None if object_id is None else MapReference(0, object_id),
        position=None if x is None else MeasuredPosition(x, 0.0, (1.0, 0.0, 1.0)),
    )


@pytest.mark.parametrize(
    ("report", "wrong"),
    [
        (_report(SEEN, object_id=1), False),
        (_report(MISSED, object_id=1), True),
        (_report(BLOCKED, object_id=1), False),
        (_report(FAINT, object_id=1), False),
        (_report(SEEN, object_id=2), True),
        (_report(MISSED, object_id=2), False),
        (_report(BLOCKED, object_id=2), False),
        (_report(FOUND, x=102.0), False),
        (_report(FOUND, x=104.0), True),
        (_report(FOUND, x=0.0), True),  # the map has that one
        (_report(MISSED, x=101.0), True),  # takes back a find that is there
        (_report(MISSED, x=60.0), False),
    ],
)
def test_a_report_is_wrong_if_it_contradicts_the_truth(report: PassReport, wrong: bool) -> None:
    (told,) = judge([(report, True)], FACTS, lambda x, y: np.array([x, y]), start=START, radius_m=3.0)
    assert told == ToldPass(7.5, True, wrong)


def test_a_run_is_lost_from_the_first_pose_beyond_the_limit_or_without_a_number() -> None:
    times = np.array([1.0, 2.0, 3.0])
    assert lost_at(times, np.array([0.1, 3.1, 0.1]), 3.0) == 2.0
    assert lost_at(times, np.array([0.1, 0.2, math.nan]), 3.0) == 3.0
    assert lost_at(times, np.array([3.0, 3.0, 3.0]), 3.0) == math.inf


def _trust(diverged: bool, *told: tuple[float, bool, bool], lost: float = 10.0) -> Trust:
    return Trust(tuple(ToldPass(*one) for one in told), diverged, lost if diverged else math.inf)


def test_a_warning_counts_only_if_it_comes_before_the_lost_filter_s_first_wrong_report() -> None:
    in_time = _trust(True, (5.0, True, True), (12.0, False, False), (20.0, True, True))
    with_it = _trust(True, (12.0, False, True))
    too_late = _trust(True, (12.0, True, True), (13.0, False, True))
    never = _trust(True, (12.0, True, False))
    assert in_time.flagged_before_wrong
    assert with_it.flagged_before_wrong
    assert not too_late.flagged_before_wrong
    assert too_late.flagged
    assert not never.flagged_before_wrong
    healthy, alarmed = _trust(False, (5.0, True, True)), _trust(False, (5.0, False, False))
    found_back = Trust((ToldPass(11.0, False, False), ToldPass(60.0, True, False)), diverged=False, lost_at=10.0)
    assert alarmed.flagged_while_right
    assert found_back.flagged
    assert not found_back.flagged_while_right  # it was lost for a while, and said so
    some = trust_figures([healthy, alarmed, found_back])
    assert some["healthy_flagged"] == 2 / 3
    assert some["healthy_flagged_while_right"] == 1 / 3
    assert some["healthy_reports_flagged"] == 2 / 4
    figures = trust_figures([in_time, with_it, too_late, never, healthy, alarmed])
    assert figures["diverged_runs"] == 4
    assert figures["diverged_flagged"] == 3 / 4
    assert figures["diverged_flagged_before_wrong"] == 2 / 4
    assert figures["diverged_without_wrong_report"] == 1
    assert figures["healthy_flagged"] == 1 / 2
    assert figures["reports"] == {
        "all": 9,
        "flagged": 4,
        "wrong": 6,
        "wrong_flagged": 2,
        "wrong_when_lost": 4,
        "wrong_when_lost_flagged": 2,
    }


def test_a_share_of_nothing_is_no_number() -> None:
    figures = trust_figures([_trust(False)])
    assert math.isnan(figures["diverged_flagged_before_wrong"])
    assert figures["healthy_flagged"] == 0.0
