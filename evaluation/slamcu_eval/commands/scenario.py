"""`slamcu-eval scenario`: the whole product in one story with faults, and the parts of the demonstration."""

from __future__ import annotations

import tempfile
import threading
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from slamcu_client import Server
from slamcu_core.errors import SlamcuError
from slamcu_eval.console import console
from slamcu_eval.fleet import Provider, standing_changes
from slamcu_eval.scenario import ContainerSystem, Plan, ProcessSystem, System, Timeline, tell
from slamcu_eval.scenario.relay import Relay
from slamcu_eval.scenario.reviewer import accept_confirmed, wait_until_quiet
from slamcu_eval.scenario.world import set_stage
from slamcu_eval.signals import signals_as_exit

IN_CONTAINERS = Plan(
    length_km=3.0, normal=12, deleted=3, new=4, pace=1.2, second_pace=1.2, cut_s=30.0, cut_at=0.5,
    kills=((0.15, "api-1"), (0.25, "worker-1"), (0.35, "database")), patience_s=300.0,
)  # fmt: skip

Address = Annotated[str, typer.Option("--server", help="The address of the API.")]
MapName = Annotated[str, typer.Option("--map", help="The name of the map.")]
KeyFile = Annotated[Path, typer.Option(envvar="SLAMCU_API_KEY_FILE", help="File with the provider's key.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    scenario = typer.Typer(help="The whole product in one story, and its parts.", no_args_is_help=True)
    app.add_typer(scenario, name="scenario")
    for command in (_run, _stage, _relay, _review, _verdict):
        scenario.command(command.__name__.removeprefix("_"))(command)


def _run(
    *,
    containers: Annotated[
        bool, typer.Option("--containers", help="In the containers of docker-compose.yml, after make images.")
    ] = False,
    compose: Annotated[Path, typer.Option(help="The folder with docker-compose.yml.")] = Path(),
    port: Annotated[
        int | None, typer.Option(help="Where the containers publish the API on this machine; else a free port.")
    ] = None,
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
    timeline = Timeline(_say)
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


def _stage(
    *,
    out: Annotated[Path, typer.Option(help="Folder for the map, its truth and the drives.")],
    cars: Annotated[int, typer.Option(min=1, help="How many drives.")] = 8,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the road and the drives.")] = 7,
) -> None:
    """Simulate the story's road, out of date, and drives along it of today; nothing if they are there."""
    if (out / "map.geojson").exists() and any((out / "drives").glob("*.gz")):
        _say(f"{out}: the road and its drives are there")
        return
    stage = set_stage(replace(Plan(), seed=seed, cars=cars, second_cars=0), out)
    _say(f"{out}: the map {stage.name} and {len(stage.logs)} drives of up to {stage.longest_s:.0f} s")


def _relay(
    *,
    to: Annotated[str, typer.Option(help="Host and port of the server, as proxy:8000.")],
    port: Annotated[int, typer.Option(help="Where to listen, on all addresses.")] = 8000,
    cut_after: Annotated[float, typer.Option(min=0.0, help="Seconds until the network is lost.")] = 30.0,
    cut_for: Annotated[float, typer.Option(min=0.0, help="Seconds until it is back.")] = 20.0,
) -> None:
    """Be the network between cars and a server: carry connections, lose it again and again, and have it back."""
    host, _, number = to.rpartition(":")
    if not (host and number.isdecimal()):
        raise typer.BadParameter("looks like proxy:8000", param_hint="--to")
    ended = threading.Event()
    with signals_as_exit(), Relay(lambda: [(host, int(number))], host="0.0.0.0", port=port) as relay:  # noqa: S104
        while not ended.wait(cut_after):
            relay.cut()
            _say(f"the cars have lost their network for {cut_for:g} s")
            ended.wait(cut_for)
            relay.mend()
            _say("the cars have their network back")


def _review(
    *, server: Address, map_name: MapName, api_key_file: KeyFile,
    quiet: Annotated[float, typer.Option(min=0.0, help="Seconds without a new entry after which all is told.")] = 10.0,
) -> None:  # fmt: skip
    """Be a map provider: wait until the feed has nothing new to say, and accept every confirmed change."""
    with _connect(server, api_key_file) as connection:
        provider = Provider(connection)
        before = provider.map_summary(map_name)["version"]
        entries = wait_until_quiet(provider, quiet)
        accepted = accept_confirmed(provider, map_name)
        after = provider.map_summary(map_name)["version"]
        counts = ", ".join(f"{number} {kind}" for kind, number in sorted(accepted.items())) or "nothing"
        _say(f"after {entries} entries of the feed: accepted {counts}; map {map_name} {before} is now {after}")


def _verdict(
    *, server: Address, map_name: MapName, api_key_file: KeyFile,
    quiet: Annotated[float, typer.Option(min=0.0, help="Seconds without a new entry after which all is told.")] = 10.0,
) -> None:  # fmt: skip
    """Say whether anything of a map is still open, and fail if so."""
    with _connect(server, api_key_file) as connection:
        provider = Provider(connection)
        wait_until_quiet(provider, quiet)
        changes = standing_changes(provider, map_name)
        still = [f"{one['kind']} {one['sign']}" for one in changes if one["state"] == "confirmed"]
        accepted = sum(one["state"] == "accepted" for one in changes)
        summary = provider.map_summary(map_name)
    if still or not accepted:
        raise SlamcuError(f"{accepted} changes are accepted, and still to be reviewed: {', '.join(still) or 'none'}")
    _say(f"map {map_name} {summary['version']}: {accepted} changes accepted, and the fleet has nothing left to report")


def _connect(url: str, key_file: Path) -> Server:
    return Server(url, key_file.read_text(encoding="utf-8").strip())


def _say(line: str) -> None:
    console.print(line, markup=False, highlight=False, soft_wrap=True)
