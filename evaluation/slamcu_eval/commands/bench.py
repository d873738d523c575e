"""`slamcu-eval bench`: how fast the parts are on this machine."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_eval.bench.filter_step import bench_filter
from slamcu_eval.console import console, error_console, write_json


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("bench")
    def _bench(
        particles: Annotated[list[int] | None, typer.Option(min=2, help="Particles; may be given again.")] = None,
        seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated drive.")] = 0,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    ) -> None:
        """Measure the filter's step on this machine; compare ratios between machines, never absolutes."""
        error_console.print("filter: one simulated drive per number of particles")
        figures: dict[str, Any] = {"machine": _machine(), "filter_step": bench_filter(particles or [100, 1_000], seed)}
        console.print(_filter_table(figures["filter_step"]))
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
