"""The script that makes the database's container: what fails in it is not passed over."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from slamcu_server.database.postgres_tools import PostgresTools, RunAs

SCRIPT = Path(__file__).parents[2] / "containers" / "database-entrypoint"


@pytest.mark.parametrize(
    ("statement", "succeeds"), [("CREATE ROLE somebody;", True), ("CREATE EXTENSION there_is_none;", False)]
)
def test_a_statement_that_fails_ends_the_start(short_dir: Path, statement: str, succeeds: bool) -> None:
    text = SCRIPT.read_text(encoding="utf-8")
    found = re.search(r"^alone\(\) .*$", text, re.MULTILINE)
    assert found is not None
    assert text.startswith("#!/bin/bash\n")
    assert "set -euo pipefail" in text
    user = RunAs.current()
    tools = PostgresTools.find(user)
    data = short_dir / f"entrypoint-{succeeds}"
    data.mkdir(mode=0o700)
    if user.drop:
        os.chown(data, user.uid, user.gid)
    assert tools.run("initdb", "--pgdata", str(data), "--auth=trust").returncode == 0
    identity = {"user": user.uid, "group": user.gid, "extra_groups": []} if user.drop else {}
    done = subprocess.run(
        ["bash", "-euc", f'{found.group()}\nalone "$1" postgres <<<"$2"\necho went on', "-", str(data), statement],
        env={"PATH": f"{tools.bin_dir}:/usr/bin:/bin", "LC_ALL": "C"}, cwd="/", capture_output=True, text=True,
        check=False, **identity,
    )  # fmt: skip
    assert ("went on" in done.stdout, done.returncode == 0) == (succeeds, succeeds), done.stderr
