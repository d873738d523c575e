"""HD maps: import-map."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from slamcu_core import program
from slamcu_core.hd_map import MapIdentity
from slamcu_server.commands.common import DataDir, in_transaction, say
from slamcu_server.maps.map_file import MapFormat
from slamcu_server.settings import Settings


def register(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.command("import-map")(import_map)


def import_map(
    *,
    path: Annotated[
        Path, typer.Argument(metavar="FILE", help="An HD map: GeoJSON, or Lanelet2 (.osm); gzipped or not.")
    ],
    source: Annotated[str, typer.Option(help="The map's name, where the file does not say or says another.")] = "",
    version: Annotated[str, typer.Option(help="Its version, likewise.")] = "",
    map_format: Annotated[
        MapFormat | None, typer.Option("--format", help="What the file is written in, where its name does not say.")
    ] = None,
    surveyed_at: Annotated[
        datetime | None,
        typer.Option(
            formats=["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S%z"],
            help="When it was surveyed: changes of older evidence that the map does not show are contradicted.",
        ),
    ] = None,
    surveyed_bbox: Annotated[
        str | None, typer.Option(metavar="W,S,E,N", help="Where it was surveyed, in degrees; without it, everywhere.")
    ] = None,
    data_dir: DataDir = None,
) -> None:
    """Make a file the first, or the next, version of the map that it names; all of it or nothing.

    Of a Lanelet2 map, which names none (give --source and --version), traffic signs and traffic lights are taken; the
    id of a feature is that of its way.

    Features keep their identity through their ids: one that the map had before stays the same feature, with what
    vehicles reported about it as long as it is the same thing at the same place; one that is missing is no longer part
    of the map. Open changes that the new version shows are absorbed.
    """
    with program.ends_at_once():
        from slamcu_server.aggregation.policy import load_policy  # noqa: PLC0415  (the other commands start faster)
        from slamcu_server.changes import rebase  # noqa: PLC0415

    survey = rebase.Survey.parse(surveyed_at, surveyed_bbox)
    identity = MapIdentity(source, version)
    policy = load_policy(Settings.load(data_dir=data_dir).policy_file)
    done, rebased = in_transaction(
        data_dir,
        lambda connection: rebase.import_and_rebase(
            connection, policy, path, identity=identity, map_format=map_format, survey=survey
        ),
    )
    name = f"map {done.identity.source} version {done.identity.version}"
    if done.unknown_signs:
        numbers = ", ".join(f"{code or 'none'} ({count})" for code, count in sorted(done.unknown_signs.items()))
        say(f"signs without a known type, to be matched by class alone: {numbers}")
    if done.unchanged:
        say(f"{name} is here already, with the same {done.features} features: nothing to do")
        return
    changes = f"{done.added} added, {done.changed} changed, {done.removed} removed since the version before"
    say(f"{name}: {done.features} features; {changes if done.sequence > 1 else 'it is the first version'}")
    if rebased != rebase.Rebased():
        say(
            f"changes: {rebased.absorbed} absorbed, {rebased.contradicted} contradicted, "
            f"{rebased.still_open} still open"
        )
