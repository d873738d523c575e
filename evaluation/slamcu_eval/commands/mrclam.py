"""`slamcu-eval mrclam`: recorded robots against wrong maps, alone and as a fleet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_core.errors import SlamcuError
from slamcu_eval.console import confusion_table, console, progress, share, write_json
from slamcu_eval.mrclam.experiment import DIVERGED_RMSE_M, RobotRun, run_experiment
from slamcu_eval.mrclam.figures import mrclam_figures
from slamcu_eval.mrclam.files import WHERE_TO_GET, MissingRecordingError
from slamcu_eval.mrclam.robots import Setting


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("mrclam", epilog=WHERE_TO_GET)
    def _mrclam(
        *,
        directory: Annotated[
            Path, typer.Argument(help="Folder with the recorded sessions, MRCLAM_Dataset1 and so on.")
        ],
        sessions: Annotated[str, typer.Option(help="Numbers of the sessions, with commas.")] = "2,4",
        duration: Annotated[float, typer.Option(min=10.0, help="Seconds of each run, from its start.")] = 600.0,
        begin: Annotated[
            float, typer.Option(min=0.0, help="Seconds into the recordings at which the runs start.")
        ] = 0.0,
        edits: Annotated[int, typer.Option(min=1, max=1_000, help="Wrong maps per session.")] = 3,
        seed: Annotated[int, typer.Option(min=0, help="Seed of maps, start errors and filters.")] = 0,
        particles: Annotated[int, typer.Option(min=2, max=100_000, help="Particles of the filter.")] = 100,
        jobs: Annotated[
            int | None, typer.Option(min=1, help="Robots at a time; one per processor if not given.")
        ] = None,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    ) -> None:
        """Drive recorded robots (UTIAS MRCLAM) against maps with 3 landmarks missing and 3 that are not there.

        Each robot is scored alone; then all robots of a session report to a real server, and its map is scored.
        """
        if not directory.is_dir():
            raise MissingRecordingError(directory)
        setting = Setting(directory.absolute(), numbers(sessions), duration, begin, edits, seed, particles)
        with progress() as bars:
            bar = bars.add_task("starting a server", total=None)
            shares: dict[int, float] = {}

            def announce(names: Sequence[str]) -> None:
                bars.update(bar, description=f"{len(names)} robot runs of {duration:g} s", total=len(names))

            def tell(run: int, done: float) -> None:
                shares[run] = done
                bars.update(bar, completed=sum(shares.values()))

            single, fused = run_experiment(setting, jobs=jobs, begin=announce, tell=tell)
        figures = mrclam_figures(single, fused)
        console.print(confusion_table(figures["pooled"]["fused"]["confusion"]))
        console.print(_table(figures))
        _name_diverged(single)
        if json_file is not None:
            write_json(json_file, figures)


def numbers(text: str) -> tuple[int, ...]:
    """Return the numbers of sessions that an option names."""
    try:
        numbers = tuple(dict.fromkeys(int(part) for part in text.split(",")))
    except ValueError:
        raise SlamcuError(f"--sessions takes numbers with commas, such as 2,4, not {text!r}") from None
    return numbers


def _table(figures: dict[str, Any]) -> Table:
    table = Table(title="Recorded robots against wrong maps: one robot alone, and all robots of a session together")
    blocks = {**{f"session {name}": block for name, block in figures["sessions"].items()}, "pooled": figures["pooled"]}
    table.add_column("figure")
    for name in blocks:
        table.add_column(name, justify="right")
    alone, together = ([block[part] for block in blocks.values()] for part in ("single", "fused"))
    health = [block["health"] for block in alone]
    rows = [
        ("one robot: right", [f"{block['accuracy']:.1%}" for block in alone]),
        ("  95 % interval by run", ["{:.1%} to {:.1%}".format(*block["accuracy_ci95"]) for block in alone]),
        ("  error of new landmarks, mean", [_metres(block) for block in alone]),
        ("  false new per run", [f"{block['false_new_per_run']:.2f}" for block in alone]),
        ("  diverged runs", [f"{block['diverged_runs']} of {block['runs']}" for block in alone]),
        ("  of them flagged before a wrong report", [share(one["diverged_flagged_before_wrong"]) for one in health]),
        ("  healthy runs wrongly flagged", [share(one["healthy_flagged"]) for one in health]),
        ("  pose error, median over runs", [f"{block['pose_rmse_median_m']:.2f} m" for block in alone]),
        ("the fleet: right", [f"{block['accuracy']:.1%}" for block in together]),
        ("  right of all", [_right(block["confusion"]) for block in together]),
        ("  error of new landmarks, mean", [_metres(block) for block in together]),
        ("  false new", [str(block["false_new"]) for block in together]),
    ]
    for name, cells in rows:
        table.add_row(name, *cells)
    step = figures["step_ms"]
    table.caption = f"a step takes {step['mean']:.2f} ms (median {step['p50']:.2f}, 99th percentile {step['p99']:.2f})"
    return table


def _metres(block: dict[str, Any]) -> str:
    return f"{block['new_position_error_m']['mean']:.2f} m"


def _right(confusion: dict[str, dict[str, int]]) -> str:
    right = sum(row[truth] for truth, row in confusion.items())
    return f"{right} of {sum(sum(row.values()) for row in confusion.values())}"


def _name_diverged(single: Sequence[RobotRun]) -> None:
    for run in single:
        if run.diverged:
            console.print(f"diverged (pose error over {DIVERGED_RMSE_M} m): {run.name}, {run.pose_rmse_m:.2f} m")
