"""The bench compares fairly and prints what it measured."""

from __future__ import annotations

import asyncio
import json
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from slamcu_eval.bench import aggregation, ingest
from slamcu_eval.bench.cloud import Cloud
from slamcu_eval.bench.rounds import interleave
from slamcu_eval.bench.server import bench_cluster
from slamcu_eval.cli import run
from slamcu_eval.commands.bench import _CLOUD, Scale
from slamcu_server.aggregation import reads, windows
from slamcu_server.aggregation.windowed import windowed_features
from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.engine import create_engine

_TICK_S = 0.0625  # exact in binary


def test_the_ways_take_turns_and_none_always_goes_first() -> None:
    calls: list[str] = []

    def way(name: str, rate: float) -> float:
        calls.append(name)
        return rate * (1 + calls.count(name))

    rates = interleave({"a": lambda: way("a", 10.0), "b": lambda: way("b", 1.0)}, rounds=3)
    rounds = [calls[i : i + 2] for i in range(0, len(calls), 2)]
    assert all(sorted(names) == ["a", "b"] for names in rounds)
    assert {names[0] for names in rounds} == {"a", "b"}
    assert rates["a"].per_round == (30.0, 40.0, 50.0), "the first round warms up and does not count"
    assert rates["a"].median == 40.0
    assert rates["a"].median / rates["b"].median == pytest.approx(10.0)


def test_the_command_prints_and_writes_the_same_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "bench.json"
    assert run(["bench", "--only", "filter", "--particles", "20", "--rounds", "1", "--json", str(file)]) == 0
    figures = json.loads(file.read_text())
    assert 7.0 < figures["scene"]["scene"]["detections"] < 13.0
    assert 27.0 < figures["scene"]["scene"]["map_features_in_view"] < 33.0
    assert 40.0 < figures["scene"]["scene"]["live_finds"] < 60.0
    kernel = figures["scene"]["kernel"]
    assert kernel["peer_over_step"] * kernel["step_over_numpy"] == pytest.approx(kernel["peer_over_numpy"])
    assert figures["scene"]["step_ms"]["20"]["processor_mean"] > 0.0
    step = figures["filter_step"]["20"]
    assert step["steps"] > 1000
    assert 0.0 < step["p50_ms"] <= step["p99_ms"]
    assert f"{step['p50_ms']:.2f} ms" in capsys.readouterr().out


@pytest.mark.slow
def test_the_server_is_measured_with_everything_taken_and_fused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(_CLOUD, Scale.SMALL, {"aggregation": (1_000, 2), "seconds": 2.0})
    monkeypatch.setattr(aggregation, "_CEILING_S", 0.2)
    monkeypatch.setattr(ingest, "perf_counter", count(step=_TICK_S).__next__)
    file = tmp_path / "bench.json"
    small = ["--rounds", "1", "--requests", "4", "--messages", "20"]
    assert run(["bench", "--only", "server", *small, "--json", str(file)]) == 0
    figures = json.loads(file.read_text())
    fused = figures["aggregation"]
    messages = figures["ingest"]["messages_per_request"]
    assert figures["ingest"]["http_over_insert"] == pytest.approx(1.0)
    assert {name: rate["median"] for name, rate in figures["ingest"]["messages_per_s"].items()} == {
        "http": 4 * messages / _TICK_S,
        "insert": 4 * messages / _TICK_S,
        "one_by_one": 4 / _TICK_S,
    }
    assert all(used > 0.0 for used in figures["ingest"]["one_by_one"]["processor_ms"].values())
    rates = {name: rate["median"] for name, rate in fused["per_s"].items()}
    assert fused["two_workers_over_slower_ceiling"] == pytest.approx(
        rates["two_workers"] / min(rates["upsert"], rates["match"])
    )
    assert figures["latency"]["probes"] > 0
    assert 0.0 < figures["latency"]["seconds"]["median"] <= figures["latency"]["seconds"]["p95"]
    assert f"{4 * messages / _TICK_S:,.0f}" in capsys.readouterr().out


@pytest.mark.slow
def test_a_history_that_is_filled_in_is_what_passes_would_have_left() -> None:
    async def windows_of(cluster: EmbeddedCluster) -> tuple[list[Any], list[Any]]:
        cloud = await Cloud.make(cluster, "history", 20, stored_per_feature=3)
        engine = create_engine(cloud.url)
        async with engine.connect() as connection:
            passes = await reads.passes_over_features(connection, None)
            features = await windowed_features(connection, dict.fromkeys(passes, 0))
        await engine.dispose()
        ends = features.window_bytes.cumsum().tolist()
        packed = [features.windows[begin:end] for begin, end in zip([0, *ends[:-1]], ends, strict=True)]
        stored = [sorted(windows.unpack(each).tolist()) for each in packed]
        return stored, [sorted(windows.pack(passes[key]).tolist()) for key in features.id.tolist()]

    with bench_cluster() as cluster:
        stored, wanted = asyncio.run(windows_of(cluster))
    assert len(stored) == 20
    assert stored == wanted
