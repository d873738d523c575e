"""`slamcu-eval bench`: how fast the parts are on this machine."""

from __future__ import annotations

import os
import platform
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_eval.bench.aggregation import bench_aggregation
from slamcu_eval.bench.filter_step import bench_filter
from slamcu_eval.bench.ingest import bench_ingest
from slamcu_eval.bench.server import bench_server
from slamcu_eval.console import console, error_console, write_json

_VEHICLES = 8


class Part(StrEnum):
    """What can be measured by itself."""

    FILTER = "filter"
    SERVER = "server"


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("bench")
    def _bench(
        *,
        only: Annotated[Part | None, typer.Option(help="Measure this part alone.")] = None,
        particles: Annotated[list[int] | None, typer.Option(min=2, help="Particles; may be given again.")] = None,
        rounds: Annotated[int, typer.Option(min=1, help="Rounds of the ingest.")] = 5,
        requests: Annotated[int, typer.Option(min=4, max=100, help="Requests per round.")] = 40,
        batches: Annotated[int, typer.Option(min=1, max=50, help="Batches of the aggregation.")] = 15,
        seed: Annotated[int, typer.Option(min=0, help="Seed of what is simulated.")] = 0,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    ) -> None:
        """Measure the filter's step, the ingest and the aggregation on this machine.

        Absolutes belong to the machine and the moment; ratios of ways that were run in turn can be compared.
        """
        figures: dict[str, Any] = {"machine": _machine()}
        if only is not Part.SERVER:
            error_console.print("filter: one simulated drive per number of particles")
            figures["filter_step"] = bench_filter(particles or [100, 1_000], seed)
            console.print(_filter_table(figures["filter_step"]))
        if only is not Part.FILTER:
            error_console.print("server: starting a private one")
            with bench_server(_VEHICLES) as server:
                error_console.print(f"ingest: {rounds} rounds of each way, in turn")
                figures["ingest"] = bench_ingest(server, rounds, requests, seed)
                error_console.print(f"aggregation: {batches} batches")
                figures["aggregation"] = bench_aggregation(server, batches)
            console.print(_server_table(figures["ingest"], figures["aggregation"]))
        if json_file is not None:
            write_json(json_file, figures)


def _machine() -> dict[str, Any]:
    return {"python": platform.python_version(), "processor": platform.machine(), "processors": os.cpu_count()}


def _filter_table(figures: dict[str, dict[str, float]]) -> Table:
    table = Table(title="Filter step: a camera frame and all since the last, 5 km of simulated motorway")
    for column in ("particles", "mean", "median", "99th percentile", "steps"):
        table.add_column(column, justify="right")
    for particles, row in figures.items():
        times = (f"{row[name]:.2f} ms" for name in ("mean_ms", "p50_ms", "p99_ms"))
        table.add_row(particles, *times, str(row["steps"]))
    return table


def _server_table(ingest: dict[str, Any], aggregation: dict[str, Any]) -> Table:
    table = Table(title=f"Server: messages of {ingest['passes_per_message']} passes, {ingest['message_bytes']} bytes")
    table.add_column("what")
    for column in ("median", "least", "most"):
        table.add_column(column, justify="right")
    http, insert = ingest["messages_per_s"]["http"], ingest["messages_per_s"]["insert"]
    rows = [
        ("ingest over HTTP, messages/s", http),
        ("bare insert of the same, messages/s", insert),
        ("aggregation by one worker, passes/s", aggregation["passes_per_s"]),
    ]
    for name, row in rows:
        table.add_row(name, *(f"{row[figure]:,.0f}" for figure in ("median", "min", "max")))
    table.add_row("ingest over bare insert", f"{ingest['http_over_insert']:.2f}", "", "")
    return table
