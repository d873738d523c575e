from __future__ import annotations

import subprocess
from collections.abc import Callable

import pytest


@pytest.mark.parametrize("after_s", [0.05, 0.3, 1.0, 2.0, 3.0, 4.0])
def test_ctrl_c_ends_an_experiment_and_its_processes_at_any_moment(
    interrupted: Callable[..., subprocess.CompletedProcess[str]], after_s: float
) -> None:
    done = interrupted("slamcu-eval", "paper", "--drives", "50", "--jobs", "2", after_s=after_s)
    assert done.returncode == 130
    assert [line for line in done.stderr.splitlines() if line.strip()] in ([], ["slamcu-eval: interrupted"])
