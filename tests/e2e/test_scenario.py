"""The whole story in plain processes: what `make e2e` tells about containers, with fewer cars and a shorter cut."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamcu_eval.scenario import Plan, ProcessSystem, Timeline, tell


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_fleet_faults_a_review_an_upgrade_and_a_restore(tmp_path: Path) -> None:
    timeline = Timeline(print)
    with ProcessSystem(tmp_path / "logs") as system:
        tell(system, Plan(), timeline)
        home = system.home
    assert len(timeline.lines) > 15
    assert not home.exists()
