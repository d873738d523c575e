"""`slamcu-eval demo`: the whole path on one screen, from drives to an accepted change."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from slamcu_core.formats import write_results
from slamcu_eval.console import console, error_console, write_json
from slamcu_eval.demo.drive import FleetResult, prepare_fleet, road_of, run_fleet
from slamcu_eval.demo.picture import draw_fleet_result
from slamcu_eval.demo.report import acceptance_table, comparison_table, demo_figures
from slamcu_eval.demo.review import Acceptance, accept_best
from slamcu_eval.fleet import Cloud, VehicleJob
from slamcu_eval.highway import World

_PICTURE, _RESULT, _FIGURES = "map.png", "result.geojson", "figures.json"


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("demo")
    def _demo(
        *,
        vehicles: Annotated[int, typer.Option(min=1, max=200, help="Cars that drive at the same time.")] = 10,
        seed: Annotated[int, typer.Option(min=0, help="Seed of the road, its signs and the drives.")] = 1,
        length_km: Annotated[float, typer.Option(min=2.0, max=50.0, help="Length of the road.")] = 20.0,
        out: Annotated[Path, typer.Option(help="Folder for picture, result and figures.")] = Path("demo-output"),
        keep: Annotated[
            bool, typer.Option("--keep", envvar="KEEP", help="Go on serving at the end, until Ctrl-C.")
        ] = False,
    ) -> None:
        """Let a fleet drive a road that has changed, fuse what it reports, and accept a change into the map.

        All of it is real but the road: a server with a PostGIS of its own, the vehicles' software in a process per
        car, SENSORIS over HTTP, and a map provider's API.
        """
        begun = time.monotonic()
        out.mkdir(parents=True, exist_ok=True)
        _say("starting a server with a PostGIS of its own")
        with Cloud() as cloud:
            _say(f"the server listens on {cloud.url}; importing the map and making a key for each car")
            world, jobs = prepare_fleet(cloud, seed, road_of(length_km), vehicles, out)
            _say(_about(world, vehicles))
            result = _drive(cloud, world, jobs)
            acceptance = accept_best(cloud, world.name)
            _write(result, out)
            console.print(comparison_table(result))
            console.print(acceptance_table(acceptance, world.name))
            _say(f"written: {out}/ {_PICTURE} (the road and its changes), {_RESULT}, {_FIGURES}")
            _say(f"{result.passes} passes in {result.messages} messages; {time.monotonic() - begun:.0f} s in all")
            if keep:
                _how_to_look_further(cloud, acceptance, world.name)
                _serve_on(cloud)
        _say("the server has stopped, and its data are gone" + ("" if keep else "; KEEP=1 make demo leaves it running"))


def _about(world: World, vehicles: int) -> str:
    kinds = [sign.truth.value for sign in world.signs]
    counts = ", ".join(f"{kinds.count(kind)} {name}" for kind, name in _KINDS.items())
    return f"{vehicles} cars drive {world.length_m / 1e3:g} km of motorway; of its signs {counts}"


_KINDS = {"normal": "are as in the map", "deleted": "are gone", "new": "are new"}


def _drive(cloud: Cloud, world: World, jobs: list[VehicleJob]) -> FleetResult:
    """Let the fleet drive, with a bar for each car."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=error_console, transient=True) as bars:
        whole = bars.add_task("the fleet", total=float(len(jobs)))
        cars = [bars.add_task(f"car {number:3d}", total=1.0) for number in range(1, len(jobs) + 1)]
        shares = [0.0] * len(jobs)

        def tell(vehicle: int, share: float) -> None:
            shares[vehicle] = share
            bars.update(cars[vehicle], completed=share)
            bars.update(whole, completed=sum(shares))

        return run_fleet(cloud, world, jobs, tell)


def _write(result: FleetResult, out: Path) -> None:
    draw_fleet_result(result, out / _PICTURE)
    (out / _RESULT).write_text("".join(write_results(result.result)), encoding="utf-8")
    write_json(out / _FIGURES, demo_figures(result))


def _how_to_look_further(cloud: Cloud, acceptance: Acceptance, map_name: str) -> None:
    change = acceptance.change["id"]
    lon, lat = acceptance.change["geometry"]["coordinates"][:2]
    box = f"{lon - 0.01:.4f},{lat - 0.01:.4f},{lon + 0.01:.4f},{lat + 0.01:.4f}"
    source = quote(map_name, safe="")
    lines = [
        "To look further as a map provider:",
        f"  export KEY={cloud.provider_key} URL={cloud.url}",
        '  curl -sH "Authorization: Bearer $KEY" "$URL/v1/changes?state=confirmed&limit=5"   # what has changed',
        f'  curl -sH "Authorization: Bearer $KEY" $URL/v1/changes/{change}   # the evidence behind a change',
        f'  curl -sH "Authorization: Bearer $KEY" "$URL/v1/maps/{source}/features?bbox={box}"   # the map around it',
        f"  {cloud.url}/docs   # the whole API",
    ]
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _serve_on(cloud: Cloud) -> None:
    _say("serving until Ctrl-C")
    try:
        cloud.wait()
    except KeyboardInterrupt:
        _say("")


def _say(text: str) -> None:
    error_console.print(text, markup=False, highlight=False, soft_wrap=True)
