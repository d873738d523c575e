"""`slamcu-eval ablation`: what each part of the filter is worth, on the same drives with one part changed at a time."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_core.errors import SlamcuError
from slamcu_eval.ablation import FULL, VARIANTS, ablation_figures, run_ablation
from slamcu_eval.commands.mrclam import numbers
from slamcu_eval.console import console, progress, write_json
from slamcu_eval.mrclam.files import MissingRecordingError
from slamcu_eval.mrclam.robots import Setting


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("ablation")
    def _ablation(
        *,
        drives: Annotated[int, typer.Option(min=0, help="Simulated drives, those of `paper` with this seed.")] = 3,
        seed: Annotated[int, typer.Option(min=0, help="Seed of worlds, drives and filters.")] = 0,
        only: Annotated[
            list[str] | None, typer.Option(help="Run this variant beside the filter as it is; may be given again.")
        ] = None,
        particles: Annotated[int, typer.Option(min=2, max=100_000, help="Particles, where not the subject.")] = 100,
        mrclam: Annotated[Path | None, typer.Option(help="Folder with recorded sessions: drive these too.")] = None,
        sessions: Annotated[str, typer.Option(help="Numbers of the recorded sessions, with commas.")] = "2,4",
        duration: Annotated[float, typer.Option(min=10.0, help="Seconds of each recorded run.")] = 150.0,
        edits: Annotated[int, typer.Option(min=1, help="Wrong maps per recorded session.")] = 1,
        jobs: Annotated[int | None, typer.Option(min=1, help="Runs at a time; one per processor if not given.")] = None,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    ) -> None:
        """Run the filter with one part at a time switched off, or put back as the paper printed it."""
        names = _names(only)
        robots = None
        if mrclam is not None:
            if not mrclam.is_dir():
                raise MissingRecordingError(mrclam)
            robots = Setting(
                mrclam.absolute(), numbers(sessions), duration, edits=edits, seed=seed, particles=particles
            )
        if not drives and robots is None:
            raise SlamcuError("--drives 0 without --mrclam leaves nothing to run")
        with progress() as bars:
            bar = bars.add_task(f"{len(names)} variants", total=None)
            cells = run_ablation(
                names,
                drives=drives,
                seed=seed,
                particles=particles,
                robots=robots,
                jobs=jobs or os.cpu_count() or 1,
                begin=lambda runs: bars.update(bar, total=runs),
                done=lambda: bars.advance(bar),
            )
        figures = ablation_figures(cells)
        for world, variants in figures.items():
            if world != "machine":
                console.print(_table(world, variants))
        if json_file is not None:
            write_json(json_file, {**figures, "seed": seed, "particles": particles})


def _names(only: list[str] | None) -> list[str]:
    unknown = sorted(set(only or ()) - VARIANTS.keys())
    if unknown:
        raise SlamcuError(f"--only takes {', '.join(VARIANTS)}; not {', '.join(unknown)}")
    return [name for name in VARIANTS if not only or name in only or name == FULL]


def _table(world: str, variants: dict[str, Any]) -> Table:
    first = next(iter(variants.values()))
    title = f"What each part is worth: {world}, {first['drives']} drives, {first['features']} features"
    table = Table(title=title, box=None, padding=(0, 1, 0, 0), pad_edge=False)
    table.caption = (
        "right and inside their 95 % ellipse in %, change of right against the first row in points with its 95 % "
        "interval by drive, false new a drive, mean error of new features and median pose error in m, mean step in ms"
    )
    table.add_column("variant", min_width=16)
    for column in ("right", "change", "interval", "false", "off", "in", "pose", "lost", "step"):
        table.add_column(column, justify="right")
    for name, variant in variants.items():
        low, high = variant["accuracy_change_ci95"]
        table.add_row(
            variant["label"],
            f"{100 * variant['accuracy']:.1f}",
            "" if name == FULL else f"{100 * variant['accuracy_change']:+.1f}",
            "" if name == FULL else f"{100 * low:+.1f} {100 * high:+.1f}",
            f"{variant['false_new_per_drive']:.1f}",
            f"{variant['new_position_error_m']:.2f}",
            f"{100 * variant['ellipse95_coverage']:.0f}",
            f"{variant['pose_rmse_median_m']:.2f}",
            str(variant["diverged_drives"]),
            f"{variant['step_ms']:.1f}",
        )
    return table
