"""`slamcu-eval simulate highway`: a world, its map and its truth, and the drives of a fleet, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_eval.console import console, error_console, progress, write_json
from slamcu_eval.highway import HighwayParameters, make_drive, make_world
from slamcu_eval.highway.files import prepare_folder, write_drive, write_world
from slamcu_eval.highway.summary import simulation_figures, summarize_drive


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    simulate = typer.Typer(help="Simulate worlds and drives.", no_args_is_help=True)
    app.add_typer(simulate, name="simulate")

    @simulate.callback()
    def _group() -> None:
        """Simulate worlds and drives."""

    @simulate.command("highway")
    def _highway(
        *,
        seed: Annotated[int, typer.Option(min=0, help="Seed of the world and its drives.")] = 0,
        vehicles: Annotated[int, typer.Option(min=1, help="Number of vehicles; each drives the road once.")] = 1,
        out: Annotated[Path | None, typer.Option(help="Folder to write map, truth, drives and references to.")] = None,
        length_km: Annotated[float, typer.Option(min=0.5, max=50.0, help="Length of the road.")] = 20.0,
        normal: Annotated[int, typer.Option(min=0, help="Signs unchanged.")] = 55,
        deleted: Annotated[int, typer.Option(min=0, help="Signs of the map that are gone.")] = 9,
        new: Annotated[int, typer.Option(min=0, help="Signs that the map lacks.")] = 39,
        moved: Annotated[int, typer.Option(min=0, help="Signs that stand 5 to 25 m from where the map has them.")] = 0,
        modified: Annotated[int, typer.Option(min=0, help="Signs that show something else than in the map.")] = 0,
        common_range_bias: Annotated[float, typer.Option(help="Range bias of all vehicles alike (0.02: 2 %).")] = 0.0,
        describe: Annotated[bool, typer.Option("--describe", help="Only show the sensor's figures.")] = False,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the sensor's figures here.")] = None,
    ) -> None:
        """Simulate the paper's motorway: a map out of date, and a fleet that drives along it.

        The drive logs hold what vehicles would record and nothing of the truth. The table shows what the simulated
        sensor turned out to be, measured from these drives; docs/simulator.md states the model.
        """
        if out is None and not describe:
            raise typer.BadParameter("name a folder, or ask to --describe only", param_hint="--out")
        parameters = HighwayParameters().having(
            length_m=1e3 * length_km,
            normal=normal,
            deleted=deleted,
            new=new,
            moved=moved,
            modified=modified,
            common_range_bias=common_range_bias,
        )
        world = make_world(seed, parameters.world)
        folder = None if describe else out
        if folder is not None:
            prepare_folder(folder)
            write_world(world, folder)
        summaries = []
        with progress() as bars:
            for vehicle in bars.track(range(vehicles), description=f"{vehicles} drives of {length_km:g} km"):
                drive = make_drive(world, seed, vehicle, parameters)
                if folder is not None:
                    write_drive(drive, folder)
                summaries.append(summarize_drive(world, drive))
        figures = simulation_figures(summaries)
        console.print(_table(figures))
        if json_file is not None:
            write_json(json_file, figures)
        if folder is not None:
            error_console.print(f"written: {folder}/ map.geojson, truth.geojson, drives, reference", highlight=False)


def _table(figures: dict[str, Any]) -> Table:
    table = Table(title="The simulated sensor, as measured from these drives")
    table.add_column("figure")
    table.add_column("value", justify="right")
    single, oracle = figures["single_sighting_error_m"], figures["oracle_error_m"]
    rows = (
        ("drives", str(figures["drives"])),
        ("minutes per drive", f"{figures['minutes_per_drive']:.1f}"),
        ("passes (sign in view)", str(figures["passes"])),
        ("frames in view per pass", f"{figures['frames_per_pass']:.1f}"),
        ("detection probability per frame", f"{figures['detection_probability']:.3f}"),
        ("miss after a miss", f"{figures['miss_after_miss']:.3f}"),
        ("passes wholly hidden by a truck", f"{figures['wholly_hidden_passes']:.2%}"),
        ("independent false alarms per frame", f"{figures['false_alarms_per_frame']:.4f}"),
        ("detections of ghosts per drive", f"{figures['ghost_detections_per_drive']:.1f}"),
        ("detections of painted signs per drive", f"{figures['painted_detections_per_drive']:.1f}"),
        ("range bias, root mean square", f"{figures['range_bias_rms']:.2%}"),
        ("error of a single sighting, mean", f"{single['mean']:.2f} m"),
        ("  median, 95th percentile", f"{single['median']:.2f} m, {single['p95']:.2f} m"),
        ("error of a pass with true poses, mean", f"{oracle['mean']:.2f} m"),
        ("  median, 95th percentile", f"{oracle['median']:.2f} m, {oracle['p95']:.2f} m"),
    )
    for row in rows:
        table.add_row(*row)
    return table
