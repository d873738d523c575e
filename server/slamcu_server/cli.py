"""The command `slamcu-server`; its subcommands are in `slamcu_server.commands`."""

from __future__ import annotations

import sys
from importlib.metadata import version
from typing import Annotated

import typer

from slamcu_core.errors import SlamcuError
from slamcu_server.commands import evidence, keys, maps, processes
from slamcu_server.commands.common import say

app = typer.Typer(
    name="slamcu-server",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="""The cloud side of slamcu: takes the change reports of vehicles, fuses them, and serves map changes.

First steps:

    slamcu-server import-map town.geojson
    slamcu-server create-key --role provider --label town-maps
    slamcu-server create-key --role vehicle --count 20 --label van
    slamcu-server serve

Without SLAMCU_DATABASE_URL the server keeps a private PostgreSQL cluster with PostGIS in SLAMCU_DATA_DIR; the commands
may run side by side. Every setting is an environment variable that begins with SLAMCU_.""",
)
for _commands in (processes, evidence, maps, keys):  # the order of the help
    _commands.register(app)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(version("slamcu-server"))
        raise typer.Exit


@app.callback()
def _options(
    *,
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command; a user's mistake gets one line and a status that is not 0."""
    try:
        app()
    except SlamcuError as error:
        say(f"slamcu-server: {error}")
        sys.exit(1)
