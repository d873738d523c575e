from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

import pytest

from slamcu_client import Server, TransportError
from slamcu_core.formats import read_results, read_truth
from slamcu_eval.cli import run


@pytest.mark.slow
def test_the_demo_fuses_a_fleet_draws_the_road_and_accepts_a_change(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--vehicles", "3", "--seed", "3", "--length-km", "2.5", "--out", str(tmp_path)]
    assert run(["demo", *options]) == 0
    said = capsys.readouterr()

    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    with (tmp_path / "truth.geojson").open("rb") as file:
        true = list(read_truth(file))
    with (tmp_path / "result.geojson").open("rb") as file:
        told = list(read_results(file))
    mapped = {feature.map_object_id for feature in true} - {None}
    assert {feature.map_object_id for feature in told} - {None} == mapped
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["vehicles"] == 3
    assert figures["fleet"]["features"] == len(true)
    assert figures["one_car"]["features"] == 3 * len(true)
    assert figures["messages"] > 0

    assert re.search(r"Change \d+ accepted through the API", said.out)
    assert "curl" not in said.out  # there is nobody left to ask
    assert "the server has stopped, and its data are gone; KEEP=1" in said.err


@pytest.mark.slow
@pytest.mark.usefixtures("ctrl_c")
def test_a_kept_demo_goes_on_serving_what_it_printed_until_ctrl_c(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "slamcu_eval", "demo"]
    options = ["--vehicles", "3", "--seed", "3", "--length-km", "2", "--out", str(tmp_path)]
    process = subprocess.Popen(
        [*command, *options],
        env=os.environ | {"KEEP": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        printed = _until(process.stdout, "/docs")
        key, url = re.findall(r"export KEY=(\S+) URL=(\S+)", printed)[0]
        change = re.findall(r"\$URL(/v1/changes/\d+) ", printed)[0]
        _until(process.stderr, "serving until Ctrl-C")
        with Server(url, key) as server:
            _, answer = server.exchange("GET", change)
            assert json.loads(answer.content)["state"] == "accepted"
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
        assert process.returncode == 0
        with Server(url, key) as server, pytest.raises(TransportError):
            server.exchange("GET", change)
    finally:
        process.kill()
        process.communicate()


def _until(stream: IO[str], word: str) -> str:
    """Read lines up to the one with a word in it."""
    lines = []
    for line in stream:
        lines.append(line)
        if word in line:
            return "".join(lines)
    raise AssertionError(f"{word!r} was never printed, but: {''.join(lines)}")
