"""The script that makes the database's container: what fails in it is not passed over."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from slamcu_server.database.postgres_tools import PostgresTools, RunAs

SCRIPT = Path(__file__).parents[2] / "containers" / "database-entrypoint"


@pytest.mark.parametrize("extension", ["postgis", "there_is_none"])
def test_a_database_without_its_extension_ends_the_start(short_dir: Path, extension: str) -> None:
    """PostGIS runs into errors of its own while it is made, and handles them: those must not end the start."""
    text = SCRIPT.read_text(encoding="utf-8")
    alone = re.search(r"^alone\(\) \{.*?^\}$", text, re.MULTILINE | re.DOTALL)
    steps = re.findall(r'^ *alone "\$unfinished" slamcu .*$', text, re.MULTILINE)
    assert alone is not None
    assert len(steps) == 2
    assert text.startswith("#!/bin/bash\n")
    assert "set -euo pipefail" in text
    program = "\n".join(
        [alone.group(), 'alone "$unfinished" postgres <<<"CREATE DATABASE slamcu;"', *steps, "echo went on"]
    )
    user = RunAs.current()
    tools = PostgresTools.find(user)
    data = short_dir / f"entrypoint-{extension}"
    data.mkdir(mode=0o700)
    if user.drop:
        os.chown(data, user.uid, user.gid)
    assert tools.run("initdb", "--pgdata", str(data), "--auth=trust").returncode == 0
    identity = {"user": user.uid, "group": user.gid, "extra_groups": []} if user.drop else {}
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", program.replace("postgis", extension)],
        env={"PATH": f"{tools.bin_dir}:/usr/bin:/bin", "LC_ALL": "C", "unfinished": str(data)}, cwd="/",
        capture_output=True, text=True, check=False, **identity,
    )  # fmt: skip
    succeeds = extension == "postgis"
    assert ("went on" in done.stdout, done.returncode == 0) == (succeeds, succeeds), done.stderr
