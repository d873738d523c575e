from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.mark.parametrize("command", [("serve", "--port", "0"), ("worker",)])
@pytest.mark.parametrize("after_s", [0.05, 0.2, 0.5, 1.0, 1.5, 2.0])
def test_ctrl_c_ends_the_start_of_a_server_at_any_moment(
    interrupted: Callable[..., subprocess.CompletedProcess[str]],
    server_environment: dict[str, str],
    short_dir: Path,
    command: tuple[str, ...],
    after_s: float,
) -> None:
    environment = {name: value for name, value in server_environment.items() if name != "SLAMCU_DATABASE_URL"}
    environment |= {"SLAMCU_DATA_DIR": str(short_dir / "interrupted"), "SLAMCU_LOG_LEVEL": "warning"}
    done = interrupted("slamcu-server", *command, after_s=after_s, environment=environment)
    assert done.stderr == ""
    began = "listens" in done.stdout or "aggregating" in done.stdout
    assert done.returncode == (0 if began else 130)  # what is told to serve until Ctrl-C has done so
    assert not (short_dir / "interrupted" / "cluster" / "data" / "postmaster.pid").exists()


@pytest.mark.parametrize("command", [("serve", "--port", "0"), ("worker",)])
def test_ctrl_c_just_before_it_serves_is_still_of_the_start(
    server_environment: dict[str, str], command: tuple[str, ...]
) -> None:
    code = (
        "import os, signal\n"
        "from slamcu_core import program\n"
        "from slamcu_server import serving\n"
        "serving._collect_less = lambda: os.kill(os.getpid(), signal.SIGINT)\n"
        "raise SystemExit(program.run('slamcu_server.cli'))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *command],
        env=server_environment | {"SLAMCU_LOG_LEVEL": "warning"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
