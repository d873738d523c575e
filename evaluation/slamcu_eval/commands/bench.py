"""`slamcu-eval bench`: how fast the parts are on this machine."""

from __future__ import annotations

import asyncio
import os
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_eval.bench.aggregation import Load, bench_aggregation
from slamcu_eval.bench.cloud import Cloud
from slamcu_eval.bench.cloud_curves import cloud_map_curve, cloud_stored_curve
from slamcu_eval.bench.curves import drive_curve, map_curve, memory_curve
from slamcu_eval.bench.filter_step import bench_filter
from slamcu_eval.bench.ingest import bench_ingest
from slamcu_eval.bench.latency import bench_latency
from slamcu_eval.bench.scene_step import bench_scene
from slamcu_eval.bench.server import bench_cluster, bench_server
from slamcu_eval.console import console, error_console, write_json
from slamcu_eval.machine import machine
from slamcu_server.database.embedded import EmbeddedCluster

_VEHICLES = 8


class Part(StrEnum):
    """What can be measured by itself."""

    FILTER = "filter"
    CURVES = "curves"
    SERVER = "server"
    CLOUD_CURVES = "cloud-curves"


class Scale(StrEnum):
    """How far the curves go."""

    SMALL = "small"
    FULL = "full"


# 64 contributions about a feature at most: those before a full window are not kept
_CLOUD: dict[Scale, dict[str, Any]] = {
    Scale.SMALL: {
        "aggregation": (20_000, 10),
        "seconds": 20.0,
        "sizes": (10_000, 100_000),
        "stored_on": 20_000,
        "stored": (20_000, 200_000, 1_280_000),
    },
    Scale.FULL: {
        "aggregation": (100_000, 10),
        "seconds": 60.0,
        "sizes": (10_000, 100_000, 1_000_000),
        "stored_on": 160_000,
        "stored": (160_000, 1_600_000, 10_240_000),
    },
}
_CURVES: dict[Scale, dict[str, Any]] = {
    Scale.SMALL: {"sizes": (1_000, 10_000, 100_000), "lengths_km": (1, 10, 50), "hours": 0.5},
    Scale.FULL: {"sizes": (1_000, 10_000, 100_000, 1_000_000), "lengths_km": (1, 10, 100, 1_000), "hours": 24.0},
}


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("bench")
    def _bench(
        *,
        only: Annotated[Part | None, typer.Option(help="Measure this part alone.")] = None,
        particles: Annotated[list[int] | None, typer.Option(min=2, help="Particles; may be given again.")] = None,
        rounds: Annotated[int, typer.Option(min=1, help="Rounds of what takes turns.")] = 5,
        scale: Annotated[Scale, typer.Option(help="How far the curves go; full takes an hour or more.")] = Scale.SMALL,
        requests: Annotated[int, typer.Option(min=4, max=100, help="Requests per round.")] = 40,
        messages: Annotated[int, typer.Option(min=20, help="Messages that wait per round of the aggregation.")] = 4_000,
        seed: Annotated[int, typer.Option(min=0, help="Seed of what is simulated.")] = 0,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    ) -> None:
        """Measure the filter's step, its curves, the ingest and the aggregation on this machine.

        Absolutes belong to the machine and the moment; ratios of ways that were run in turn can be compared.
        """
        figures: dict[str, Any] = {"machine": _machine()}
        if only in {None, Part.FILTER}:
            counts = particles or [100, 1_000]
            error_console.print(f"filter: {rounds} rounds in a dense field of signs, in turn")
            figures["scene"] = bench_scene(counts, rounds, seed)
            console.print(_scene_table(figures["scene"]))
            error_console.print("filter: one simulated drive per number of particles")
            figures["filter_step"] = bench_filter(counts, seed)
            console.print(_filter_table(figures["filter_step"]))
        if only in {None, Part.CURVES}:
            reach = _CURVES[scale]
            error_console.print("curves: maps of different sizes")
            figures["map_size"] = map_curve(reach["sizes"], rounds)
            error_console.print("curves: after drives of different lengths")
            figures["drive_length"] = drive_curve(reach["lengths_km"], rounds)
            error_console.print(f"curves: memory over {reach['hours']:g} hours")
            figures["memory"] = memory_curve(reach["hours"])
            for table in _curve_tables(figures):
                console.print(table)
        if only in {None, Part.SERVER, Part.CLOUD_CURVES}:
            error_console.print("server: starting a private cluster")
            with bench_cluster() as cluster:
                if only is not Part.CLOUD_CURVES:
                    figures |= _server(cluster, _CLOUD[scale], requests, Load(messages, rounds, seed))
                if only is not Part.SERVER:
                    figures |= _cloud_curves(cluster, _CLOUD[scale], Load(messages, rounds, seed))
        if json_file is not None:
            write_json(json_file, figures)


def _server(cluster: EmbeddedCluster, reach: dict[str, Any], requests: int, load: Load) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    error_console.print(f"ingest: {load.rounds} rounds of each way, in turn")
    with bench_server(cluster.url, _VEHICLES, features=2_000) as server:
        figures["ingest"] = bench_ingest(server, load.rounds, requests, load.seed)
    error_console.print(f"aggregation: {load.rounds} rounds of each way, in turn")
    features, stored = reach["aggregation"]
    figures["aggregation"] = bench_aggregation(cluster, features, stored, load)
    console.print(_server_table(figures["ingest"], figures["aggregation"]))
    rate = figures["aggregation"]["per_s"]["two_workers"]["median"] / 2
    error_console.print(f"latency: {reach['seconds']:g} s at {rate:,.0f} evidences a second")
    cloud = asyncio.run(Cloud.make(cluster, "bench_latency", features, seed=load.seed, stored_per_feature=stored))
    with bench_server(cloud.url, 1) as server:
        figures["latency"] = bench_latency(cloud, server.url, (server.keys[0], server.provider), rate, reach["seconds"])
    console.print(_latency_table(figures["latency"]))
    return figures


def _cloud_curves(cluster: EmbeddedCluster, reach: dict[str, Any], load: Load) -> dict[str, Any]:
    load = replace(load, rounds=min(load.rounds, 3), messages=min(load.messages, 500))
    error_console.print("cloud: maps of different sizes")
    size = cloud_map_curve(cluster, reach["sizes"], load)
    error_console.print("cloud: more and more that is stored")
    stored = cloud_stored_curve(cluster, reach["stored_on"], reach["stored"], load)
    for title, name, curve in (
        ("Cost of an evidence against the size of the map", "map features", size),
        (f"The same against what is stored about {stored['map_features']:,} map features", "contributions", stored),
    ):
        table = _table(title, (name, "cost by the clock", "processor time"))
        for label, cost in curve["microseconds"].items():
            table.add_row(f"{int(label):,}", f"{cost:,.0f} µs", f"{curve['processor_us'][label]:,.0f} µs")
        console.print(table)
    return {"cloud_map_size": size, "cloud_stored": stored}


def _latency_table(latency: dict[str, Any]) -> Table:
    title = f"From acknowledged to visible in the feed, at {latency['evidences_per_s']:,.0f} evidences a second"
    table = _table(title, ("median", "95th percentile", "most", "probes"))
    waits = latency["seconds"]
    table.add_row(*(f"{waits[name]:.2f} s" for name in ("median", "p95", "max")), str(latency["probes"]))
    return table


def _machine() -> dict[str, Any]:
    return machine() | {"threads": os.environ.get("OPENBLAS_NUM_THREADS", "not limited")}


def _scene_table(scene: dict[str, Any]) -> Table:
    held, kernel = scene["scene"], scene["kernel"]
    table = Table(
        title=f"Dense field: {held['detections']:.1f} detections, {held['map_features_in_view']:.1f} map features in "
        f"view, {held['live_finds']:.1f} live finds"
    )
    for column in ("what", "mean", "median", "99th percentile", "of the processor", "99th percentile of that"):
        table.add_column(column, justify="left" if column == "what" else "right")
    for particles, row in scene["step_ms"].items():
        times = (f"{row[name]:.2f} ms" for name in ("mean", "p50", "p99", "processor_mean", "processor_p99"))
        table.add_row(f"step, {particles} particles", *times)
    for name, label in (("numpy", "eq. 16-19 on arrays"), ("peer", "eq. 16-19 in plain loops")):
        table.add_row(f"{label}, {kernel['particles']} particles", "", f"{kernel['ms'][name]:.2f} ms", "")
    for name, label in (
        ("peer_over_numpy", "plain loops over arrays"),
        ("peer_over_step", "plain loops of eq. 16-19 over the whole step"),
        ("step_over_numpy", "the whole step over eq. 16-19 on arrays"),
    ):
        table.add_row(label, "", f"{kernel[name]:.1f} times", "")
    return table


def _curve_tables(figures: dict[str, Any]) -> list[Table]:
    size, length, memory = figures["map_size"], figures["drive_length"], figures["memory"]
    tables = [
        _table("Step against the size of the map", ("features", "step", "time to build", "memory")),
        _table("Step against the length of the drive", ("km", "step", "rows at work")),
        _table(f"Memory of a session, {memory['map_features']:,} features in its map", ("hours", "filter holds")),
    ]
    for name, step in size["step_ms"].items():
        cost = size["map"][name]
        tables[0].add_row(f"{int(name):,}", f"{step:.2f} ms", f"{cost['build_s']:.1f} s", f"{cost['memory_mb']:.0f} MB")
    for name, step in length["step_ms"].items():
        tables[1].add_row(name, f"{step:.2f} ms", str(length["rows"][name]))
    for hours, held in zip(memory["hours"], memory["memory_mb"], strict=True):
        tables[2].add_row(f"{hours:.2f}", f"{held:.2f} MB")
    return tables


def _table(title: str, columns: tuple[str, ...]) -> Table:
    table = Table(title=title)
    for column in columns:
        table.add_column(column, justify="right")
    return table


def _filter_table(figures: dict[str, dict[str, float]]) -> Table:
    table = Table(title="Filter step: a camera frame and all since the last, 5 km of simulated motorway")
    for column in ("particles", "mean", "median", "99th percentile", "steps"):
        table.add_column(column, justify="right")
    for particles, row in figures.items():
        times = (f"{row[name]:.2f} ms" for name in ("mean_ms", "p50_ms", "p99_ms"))
        table.add_row(particles, *times, str(row["steps"]))
    return table


def _server_table(ingest: dict[str, Any], aggregation: dict[str, Any]) -> Table:
    table = Table(
        title=f"Server: messages of {ingest['passes_per_message']:.1f} passes, {ingest['message_bytes']} bytes; "
        f"{aggregation['map_features']:,} map features, {aggregation['stored_contributions']:,} stored contributions"
    )
    table.add_column("what")
    for column in ("median", "least", "most"):
        table.add_column(column, justify="right")
    http, insert, one_by_one = (ingest["messages_per_s"][way] for way in ("http", "insert", "one_by_one"))
    rates = aggregation["per_s"]
    rows = [
        ("ingest over HTTP, messages/s", http),
        ("bare insert of the same, messages/s", insert),
        (f"messages of {ingest['one_by_one']['passes_per_message']} passes, a request each, messages/s", one_by_one),
        ("acknowledged to fused by one worker, evidences/s", rates["one_worker"]),
        ("acknowledged to fused by two workers, evidences/s", rates["two_workers"]),
        ("ceiling: batched additive upsert, rows/s", rates["upsert"]),
        ("ceiling: spatial match of 1,000 points, points/s", rates["match"]),
    ]
    for name, row in rows:
        table.add_row(name, *(f"{row[figure]:,.0f}" for figure in ("median", "min", "max")))
    table.add_row("ingest over bare insert", f"{ingest['http_over_insert']:.2f}", "", "")
    share = aggregation["two_workers_over_slower_ceiling"]
    table.add_row("two workers over the slower ceiling", f"{share:.2f}", "", "")
    for name, label in (("api", "processor time of such a request: API"), ("database", "the same: database")):
        table.add_row(label, f"{ingest['one_by_one']['processor_ms'][name]:.1f} ms", "", "")
    used = aggregation["processor_us"]
    for name, label in (
        ("worker", "processor time of an evidence: worker"),
        ("database", "the same: database"),
        ("upsert", "processor time of a row: upsert"),
        ("match", "processor time of a point: match"),
    ):
        table.add_row(label, f"{used[name]:,.0f} µs", "", "")
    return table
