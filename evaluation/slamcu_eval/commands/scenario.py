"""`slamcu-eval scenario`: the whole product in one story with faults, in processes or in containers."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from slamcu_core.errors import SlamcuError
from slamcu_eval.console import console
from slamcu_eval.fleet.signals import signals_as_exit
from slamcu_eval.scenario import ContainerSystem, Plan, ProcessSystem, System, Timeline, tell

IN_CONTAINERS = Plan(
    cars=6, length_km=3.0, normal=12, deleted=3, new=4, pace=1.2, cut_s=30.0, cut_at=0.5, patience_s=300.0
)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("scenario")
    def _scenario(
        *,
        containers: Annotated[
            bool, typer.Option("--containers", help="In the containers of docker-compose.yml, after make images.")
        ] = False,
        compose: Annotated[Path, typer.Option(help="The folder with docker-compose.yml.")] = Path(),
        port: Annotated[int, typer.Option(help="Where the containers publish the API on this machine.")] = 18000,
        cars: Annotated[int | None, typer.Option(min=3, help="Cars of the first fleet.")] = None,
        seed: Annotated[int | None, typer.Option(min=0, help="Seed of the road and the drives.")] = None,
        logs: Annotated[Path, typer.Option(help="Folder for the logs and the timeline.")] = Path("build/scenario"),
    ) -> None:
        """Let a fleet drive while services are killed and its network is cut, review, upgrade, back up and restore.

        Every promise is checked from outside: over HTTP, from the cars' own outboxes, and by slamcu-server check.
        Prints what happens when, removes everything afterwards, also when it fails, and leaves the logs.
        """
        plan = IN_CONTAINERS if containers else Plan()
        plan = replace(plan, cars=cars or plan.cars, seed=plan.seed if seed is None else seed)
        logs = logs.absolute()
        logs.mkdir(parents=True, exist_ok=True)
        timeline = Timeline(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True))
        try:
            with signals_as_exit(), ExitStack() as stack:
                system: System
                if containers:
                    home = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="slamcu-e2e-")))
                    home.chmod(0o711)  # the users of the containers go through it
                    system = stack.enter_context(ContainerSystem(compose.absolute(), home, logs, port=port))
                else:
                    system = stack.enter_context(ProcessSystem(logs))
                timeline("the system is up and healthy")
                tell(system, plan, timeline)
        except SlamcuError as error:
            timeline(f"FAILED: {error}")
            raise SlamcuError(f"a promise was broken: {error} (logs: {logs})") from error
        finally:
            (logs / "timeline.txt").write_text("".join(f"{line}\n" for line in timeline.lines), encoding="utf-8")
