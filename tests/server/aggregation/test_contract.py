"""The API keeps the contract that it publishes at `/openapi.json`, whatever is sent and whoever sends it.

Schemathesis makes requests from that description, good ones and ones that break it in each way it allows, and looks
whether the answers are as described: no 500, no status, media type or member that is not told of, nothing taken that
the description rules out, and nothing without a key.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.anyio

CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_headers_conformance",
    "response_schema_conformance",
    "negative_data_rejection",
    "missing_required_header",
    "unsupported_method",
    "ignored_auth",
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("role", "phases"),
    [("admin", "examples,coverage,fuzzing"), ("vehicle", "examples,fuzzing")],
    ids=["admin", "vehicle"],
)
async def test_answers_are_as_the_api_describes_them(
    *, role: str, phases: str, town: Any, reports: Any, server_process: Any, issue_key: Any, tmp_path: Path
) -> None:
    for number in range(6):
        sighting = reports.find(100.0, 0.0, hours=number)
        await town.report(f"car-{number}", reports.missed(1, hours=number), sighting)
    await town.fuse()
    assert len(await town.changes()) >= 2
    server_process.start()
    said = await asyncio.to_thread(_examine, server_process.url, (await issue_key(role)).key, phases, tmp_path)
    assert said.returncode == 0, said.stdout + said.stderr + server_process.log.read_text()[-4000:]
    assert "Tested: 20" in said.stdout, said.stdout


def _examine(url: str, key: str, phases: str, directory: Path) -> subprocess.CompletedProcess[str]:
    program = Path(sys.executable).with_name("schemathesis")
    options = (
        *("--checks", ",".join(CHECKS), "--phases", phases, "--max-examples", "12"),
        *("--seed", "1", "--generation-deterministic", "--no-color", "--continue-on-failure"),
        *("--header", f"Authorization: Bearer {key}"),
    )
    command = [program, "run", f"{url}/openapi.json", *options]
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=240, check=False)
