"""`slamcu-eval fleet`: what many cars add, through the real client to the real server."""

from __future__ import annotations

import tempfile
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_core.errors import SlamcuError
from slamcu_eval.console import console, progress, share, write_json
from slamcu_eval.machine import machine
from slamcu_eval.many.experiment import Plan, run_road
from slamcu_eval.many.figures import KINDS, fleet_figures
from slamcu_eval.many.roads import LENGTH_M


class Switch(StrEnum):
    """Whether something is so."""

    OFF = "off"
    ON = "on"


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("fleet")
    def _fleet(
        *,
        vehicles: Annotated[str, typer.Option(help="Sizes of the fleet, comma-separated.")] = "1,3,5,10,25",
        roads: Annotated[int, typer.Option(min=1, help="Roads; 25 hold 300 signs of each kind of change.")] = 25,
        first_road: Annotated[
            int, typer.Option(min=0, help="Number of the first of them: processes may share a folder, not a road.")
        ] = 0,
        common_bias: Annotated[
            Switch, typer.Option(help="Let every car's ranges be 2 % too long, beside its own errors.")
        ] = Switch.OFF,
        seed: Annotated[int, typer.Option(min=0, help="Seed of roads, drives and filters.")] = 0,
        jobs: Annotated[int, typer.Option(min=1, help="Cars that drive at the same time.")] = 1,
        length_km: Annotated[float, typer.Option(min=1.0, help="Length of a road, with its signs as dense.")] = 10.0,
        work: Annotated[
            Path | None,
            typer.Option(help="Folder for what the cars told; a run that was stopped goes on from there."),
        ] = None,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    ) -> None:
        """Score the cloud's map of changed roads by how many cars have passed.

        Each road is the paper's motorway, 10 km long, with 100 signs as mapped, 40 new, and 12 each deleted, moved (by
        3 to 15 m) and modified (another type or value). Every car has its own biases and sees ghosts that no other car
        sees; it passes once, an hour after the one before. The map is fresh: no car has passed before.

        The first car is heard, then the first three, five and so on: each wave sets out with the map and the watch
        features that the cars before have brought about. Everything goes through the real client and server. One car
        is scored without the minimum of contributors, by the largest of the three masses.

        A car's drive takes some seconds on an idle processor: 25 roads with 25 cars some two hours. With --work, cars
        that have driven are kept and not driven again: another server hears what they told. Several processes fill one
        folder when each has roads of its own (--first-road); a last run over all of them drives nothing and counts.
        """
        sizes = _sizes(vehicles)
        with tempfile.TemporaryDirectory(prefix="slamcu-fleet-") as scratch:
            plan = Plan(
                sizes=sizes,
                seed=seed,
                common_bias=common_bias is Switch.ON,
                folder=work or Path(scratch),
                processes=jobs,
                length_m=1e3 * length_km if length_km != LENGTH_M / 1e3 else LENGTH_M,
            )
            results = []
            with progress() as bars:
                bar = bars.add_task("roads", total=roads)
                for road in range(first_road, first_road + roads):
                    results.append(
                        run_road(plan, road, lambda said, n=road: bars.update(bar, description=f"road {n + 1}: {said}"))  # type: ignore[misc]
                    )
                    bars.advance(bar)
        figures = {**fleet_figures(results, common_bias=plan.common_bias), "machine": machine()}
        console.print(_kinds_table(figures))
        console.print(_places_table(figures))
        console.print(
            f"one car without the cloud: new precision {share(figures['car_alone']['new']['precision'])}, recall "
            f"{share(figures['car_alone']['new']['recall'])}; deleted precision "
            f"{share(figures['car_alone']['deleted']['precision'])}, recall "
            f"{share(figures['car_alone']['deleted']['recall'])}"
        )
        if json_file is not None:
            write_json(json_file, figures)


def _sizes(text: str) -> tuple[int, ...]:
    try:
        sizes = sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise SlamcuError(f"--vehicles must be whole numbers with commas between them, not {text!r}") from None
    if not sizes or sizes[0] < 1 or sizes[-1] > 100:
        raise SlamcuError(f"--vehicles must lie between 1 and 100, not {text!r}")
    return tuple(sizes)


def _kinds_table(figures: dict[str, Any]) -> Table:
    table = Table(title=f"Precision and recall over {figures['roads']} roads, by vehicles that have passed")
    table.add_column("vehicles", justify="right")
    for kind in KINDS:
        table.add_column(f"{kind}: precision", justify="right")
        table.add_column("recall", justify="right")
    for size, block in figures["vehicles"].items():
        cells = [share(block[kind][name]) for kind in KINDS for name in ("precision", "recall")]
        table.add_row(size, *cells)
    return table


def _places_table(figures: dict[str, Any]) -> Table:
    table = Table(title="Places of new signs, passes to a decision, calibration")
    for column in (
        "vehicles",
        "error, mean",
        "p95",
        "with true poses",
        "in 95 % ellipse",
        "passes: new",
        "deleted",
        "ECE new",
        "deleted",
    ):
        table.add_column(column, justify="right")
    for size, block in figures["vehicles"].items():
        error, passes = block["new_position_error_m"], block["passes_to_decision"]
        table.add_row(
            size,
            f"{error['mean']:.2f} m",
            f"{error['p95']:.2f} m",
            f"{block['oracle_position_error_m']:.2f} m",
            share(block["ellipse95_coverage"]),
            *(f"{passes[kind]['median']:g} ({passes[kind]['p95']:g})" for kind in ("new", "deleted")),
            *(f"{block['ece'][kind]:.3f}" for kind in ("new", "deleted")),
        )
    return table
