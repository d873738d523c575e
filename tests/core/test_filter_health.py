"""When the filter says that it is lost: by encounters with distinct things, and how rarely it cries wolf."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from slamcu_core.filter.health import HealthMonitor

RATE = 0.6  # detections due per look
WELL, BADLY = 1.0, 13.0  # squares of innovations


@pytest.fixture
def monitor() -> HealthMonitor:
    return HealthMonitor(concentration=4.0, gate=13.8, unmapped_share=0.2)


class Watch:
    """Shows a monitor one thing after the other, each for some looks."""

    def __init__(self, monitor: HealthMonitor) -> None:
        self.monitor, self.t = monitor, 0.0

    def pass_by(
        self, row: int, hits: ArrayLike, *, mapped: bool = True, exists: float = 0.97, square: float = WELL
    ) -> None:
        """Have a thing in view for as many looks as there are `hits`, then nothing for ten seconds."""
        for hit in np.asarray(hits, float):
            self.t += 0.3
            self.monitor.note(
                self.t,
                np.array([row]),
                np.array([mapped]),
                shown=np.ones(1),
                due=np.array([RATE]),
                hit=np.array([hit]),
                exists=lambda rows: np.full(len(rows), exists),
                squares=np.array([square if hit else 0.0]),
            )
        self.t += 10.0


MISSED, SEEN = np.zeros(12), np.ones(12)


def test_one_hidden_sign_is_no_reason_to_be_lost_however_long_it_is_looked_at(monitor: HealthMonitor) -> None:
    Watch(monitor).pass_by(3, np.zeros(5000))
    assert not monitor.lost


def test_what_is_known_to_be_gone_says_nothing_when_it_is_missed_again(monitor: HealthMonitor) -> None:
    watch = Watch(monitor)
    for _ in range(50):
        watch.pass_by(3, MISSED, exists=0.02)
    assert not monitor.doubtful


def test_many_things_missing_and_others_in_their_stead_mean_lost_and_the_map_s_own_end_that(
    monitor: HealthMonitor,
) -> None:
    watch = Watch(monitor)
    for row in range(10):
        watch.pass_by(row, SEEN)  # a long good time does not speak against a loss
    for row in range(20, 26):
        watch.pass_by(row, MISSED)
        watch.pass_by(row + 20, SEEN, mapped=False, exists=0.5)
    assert monitor.lost
    assert not monitor.state(1.0).trusted
    watch.pass_by(100, SEEN)
    assert monitor.lost  # one thing in its place may be chance
    for row in range(101, 110):
        watch.pass_by(row, SEEN)
    assert not monitor.lost


def test_things_that_fit_badly_speak_against_the_pose(monitor: HealthMonitor) -> None:
    watch = Watch(monitor)
    for row in range(6):
        watch.pass_by(row, SEEN, square=BADLY)
    assert monitor.lost


def test_a_new_start_forgets_what_spoke_against_the_old_pose(monitor: HealthMonitor) -> None:
    watch = Watch(monitor)
    for row in range(8):
        watch.pass_by(row, MISSED)
    assert monitor.lost
    monitor.reset()
    assert not monitor.lost
    assert not monitor.doubtful


def _hits(rng: np.random.Generator, stands: bool) -> NDArray[np.float64]:
    """Return the detections of a pass, its detection probability drawn anew: misses come in bursts."""
    rate = rng.beta(4.0 * RATE, 4.0 * (1.0 - RATE))
    return (rng.random(12) < rate * stands).astype(float)


def test_a_healthy_filter_on_an_old_map_rarely_cries_wolf(monitor: HealthMonitor) -> None:
    rng, alarms = np.random.default_rng(5), 0
    watch = Watch(monitor)
    for row in range(2000):
        watch.pass_by(row % 60, _hits(rng, rng.random() < 0.9), square=float(rng.chisquare(2)))
        if rng.random() < 0.2:
            watch.pass_by(60 + row % 60, SEEN, mapped=False, exists=0.5)
        if monitor.lost:
            alarms += 1
            monitor.reset()
    assert alarms <= 3  # one is due: two thousand signs are twenty drives, and five of a hundred drives may
