from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.mark.parametrize("after_s", [0.05, 0.1, 0.2, 0.3, 0.5, 1.5])
def test_ctrl_c_ends_the_vehicle_at_any_moment(
    interrupted: Callable[..., subprocess.CompletedProcess[str]], after_s: float, tmp_path: Path
) -> None:
    """While it imports it says nothing; then it waits for a map that cannot be had, and says in a line that it ends."""
    log = tmp_path / "drive.jsonl"
    server = ("--server", "http://127.0.0.1:1", "--api-key", "key")
    done = interrupted("slamcu-vehicle", "drive", "--map-name", "town", "--log", str(log), *server, after_s=after_s)
    assert done.returncode == 130
    assert done.stdout == ""
    remarks = [line for line in done.stderr.splitlines() if "no map yet" not in line]
    assert remarks in ([], ["slamcu-vehicle: interrupted; what is in the outbox stays there"])
