"""`slamcu-eval paper`: the paper's experiment, simulated, beside the figures that the paper published."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_eval.console import confusion_table, console, progress, share, write_json
from slamcu_eval.paper import DIVERGED_RMSE_M, PUBLISHED, Outcome, paper_figures, run_drives
from slamcu_eval.records import write_records


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("paper")
    def _paper(
        *,
        drives: Annotated[int, typer.Option(min=1, help="Number of drives, each in a world of its own.")] = 3,
        seed: Annotated[int, typer.Option(min=0, help="Seed of worlds, drives and filters.")] = 0,
        particles: Annotated[int, typer.Option(min=2, max=100_000, help="Particles of the filter.")] = 100,
        jobs: Annotated[
            int, typer.Option(min=1, help="Drives at a time; above 1 their steps wait for each other.")
        ] = 1,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
        records_file: Annotated[
            Path | None,
            typer.Option("--records", help="Write a record per feature to this file, as JSON lines."),
        ] = None,
    ) -> None:
        """Run the filter over the paper's motorway: 20 km, 55 signs unchanged, 9 deleted, 39 new."""
        with progress() as bars:
            bar = bars.add_task(f"{drives} drives, {particles} particles", total=drives)
            outcomes = run_drives(drives, seed, particles, jobs=min(drives, jobs), done=lambda: bars.advance(bar))
        figures = paper_figures(outcomes, particles)
        console.print(confusion_table(figures["confusion"]))
        console.print(_beside_the_paper(figures))
        _name_diverged(outcomes)
        if json_file is not None:
            write_json(json_file, figures)
        if records_file is not None:
            write_records(records_file, (record for outcome in outcomes for record in outcome.records))


def _beside_the_paper(figures: dict[str, Any]) -> Table:
    table = Table(title="The paper's experiment, simulated")
    for column, side in (("figure", "left"), ("here", "right"), ("published 2018", "right")):
        table.add_column(column, justify="right" if side == "right" else "left")
    error, oracle, single = (figures[f"{name}_error_m"] for name in ("new_position", "oracle", "single_sighting"))
    low, high = figures["accuracy_ci95"]
    ratio = figures["error_over_oracle"]
    step, health, theirs = figures["step_ms"], figures["health"], PUBLISHED
    rows = [
        ("drives", str(figures["drives"]), str(theirs["drives"])),
        ("features", str(figures["features"]), str(theirs["features"])),
        ("accuracy", f"{figures['accuracy']:.2%}", f"{theirs['accuracy']:.2%}"),
        ("  95 % interval", f"{low:.1%} to {high:.1%}", "{:.1%} to {:.1%}".format(*theirs["accuracy_ci95"])),
        ("false new per drive", f"{figures['false_new_per_drive']:.2f}", ""),
        ("never in view", str(figures["never_in_view"]), ""),
        ("error of new signs, mean", f"{error['mean']:.2f} m", f"{theirs['new_position_error_m']['mean']:.1f} m"),
        ("  standard deviation", f"{error['std']:.2f} m", f"{theirs['new_position_error_m']['std']:.1f} m"),
        ("  median, 95th percentile", f"{error['median']:.2f} m, {error['p95']:.2f} m", ""),
        ("  with true poses (oracle), mean", f"{oracle['mean']:.2f} m", ""),
        ("  over the oracle's, 95 % interval", "{:.2f} ({:.2f} to {:.2f})".format(ratio["ratio"], *ratio["ci95"]), ""),
        ("  single sighting, mean", f"{single['mean']:.2f} m", ""),
        ("inside their 95 % ellipse", f"{figures['ellipse95_coverage']:.1%}", ""),
        ("pose error, root mean square", f"{figures['localization_rmse_m']:.2f} m", ""),
        ("diverged drives", str(figures["diverged_drives"]), ""),
        ("  of them flagged before a wrong report", share(health["diverged_flagged_before_wrong"]), ""),
        ("healthy drives wrongly flagged", share(health["healthy_flagged"]), ""),
        ("step, mean", f"{step['mean']:.2f} ms", f"{theirs['step_ms']['mean']:.2f} ms"),
        ("  median, 99th percentile", f"{step['p50']:.2f} ms, {step['p99']:.2f} ms", ""),
        ("particles", str(figures["particles"]), ""),
    ]
    for row in rows:
        table.add_row(*row)
    return table


def _name_diverged(outcomes: Sequence[Outcome]) -> None:
    for outcome in outcomes:
        if outcome.diverged:
            console.print(f"diverged (pose error over {DIVERGED_RMSE_M} m): {outcome.name}, {outcome.rmse_m:.1f} m")
