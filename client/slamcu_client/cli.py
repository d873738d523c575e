"""The command `slamcu-vehicle`: what it takes; `commands` says what it does."""

from __future__ import annotations

import argparse
import io
import logging
import os
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path

from slamcu_client import commands
from slamcu_client.errors import ConnectionSettingsError
from slamcu_client.version import SOFTWARE_VERSION
from slamcu_core import program
from slamcu_core.errors import SlamcuError

_KEY_VARIABLE = "SLAMCU_API_KEY"

_DESCRIPTION = """\
The vehicle side of slamcu: compare a recorded drive with an HD map and report what has changed.

  slamcu-vehicle drive --map town.geojson --log monday.jsonl.gz --result monday.geojson
      what one car says about every feature of the map, without any server

  export SLAMCU_API_KEY=...
  slamcu-vehicle drive --map-name town --log monday.jsonl.gz --server https://slamcu.example
      fetch the map, drive, and report to the server while driving

  slamcu-vehicle upload --outbox monday.jsonl.gz.outbox --server https://slamcu.example
      send what an earlier drive could not, be it days later
"""

_EPILOG = f"""\
exit codes: 0 done, 1 bad input or a refusal, 2 bad usage, 3 done but not all is with the server, 130 interrupted

Give the API key in the environment variable {_KEY_VARIABLE}, or in a file that {_KEY_VARIABLE}_FILE names: other users
of a machine can read its command lines.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files need not be text
    options = _parser().parse_args(arguments)
    logging.basicConfig(
        level=logging.INFO if options.verbose else logging.ERROR,
        format="slamcu-vehicle: %(message)s",
        stream=sys.stderr,
    )
    logging.getLogger("httpx").setLevel(logging.WARNING)
    logging.getLogger("slamcu_client.server").setLevel(logging.INFO if options.verbose else logging.WARNING)
    try:
        code = int(options.run(options))
    except SlamcuError as error:
        return _fail(str(error), 1)
    except OSError as error:
        return _fail(f"{error.filename or 'file'}: {error.strerror or error}", 1)
    except KeyboardInterrupt:
        kept = getattr(options, "outbox", None) or (options.run is _drive and options.server)
        return _fail("interrupted" + ("; what is in the outbox stays there" if kept else ""), program.INTERRUPTED)
    failure = commands.console.failure
    return code if failure is None else _fail(f"standard output: {failure.strerror or failure}", 1)


def _fail(message: str, code: int) -> int:
    commands.console.say(message)
    return code


def _drive(options: argparse.Namespace) -> int:
    if options.map_name is not None and options.server is None:
        options.usage("--map-name needs --server, to fetch the map from")
    return commands.drive(
        commands.DriveOrder(
            log=options.log,
            map_file=options.map,
            map_name=options.map_name,
            result=options.result,
            outbox=options.outbox,
            seed=options.seed,
            particles=options.particles,
            wait_s=options.wait,
            pace=options.pace,
        ),
        _server(options) if options.server else None,
    )


def _fetch_map(options: argparse.Namespace) -> int:
    return commands.fetch_map(_server(options), options.map, options.out, options.bbox)


def _upload(options: argparse.Namespace) -> int:
    return commands.upload(_server(options), options.outbox, options.wait)


def _server(options: argparse.Namespace) -> commands.ServerAddress:
    key = options.api_key or os.environ.get(_KEY_VARIABLE, "") or _key_from_file()
    if not key:
        options.usage(f"--server needs the vehicle's key: set {_KEY_VARIABLE}, or give --api-key")
    return commands.ServerAddress(options.server, key)


def _key_from_file() -> str:
    path = os.environ.get(f"{_KEY_VARIABLE}_FILE", "")
    if not path:
        return ""
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except UnicodeDecodeError as error:
        raise ConnectionSettingsError(f"{path}: holds no API key: it is not UTF-8 text") from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="slamcu-vehicle",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=SOFTWARE_VERSION)
    actions = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    drive = _command(
        actions,
        "drive",
        "run the filter over a recorded drive",
        "Compare a recorded drive with an HD map. Prints how many features are normal, deleted and new; with --server "
        "the evidence of each pass is reported as well. Reports wait in the outbox until the server has them, so an "
        "interrupted drive can be run again: nothing is reported twice.",
    )
    drive.add_argument("--log", type=Path, required=True, metavar="FILE", help="the drive log, .jsonl or .jsonl.gz")
    chart = drive.add_mutually_exclusive_group(required=True)
    chart.add_argument("--map", type=Path, metavar="FILE", help="the HD map, GeoJSON, gzipped or not")
    chart.add_argument("--map-name", type=_text, metavar="NAME", help="fetch this map from the server instead")
    drive.add_argument(
        "--result", type=Path, metavar="FILE", help="write what this car says about each feature, GeoJSON"
    )
    _add_server(drive, required=False)
    drive.add_argument(
        "--outbox",
        type=Path,
        metavar="FILE",
        help="where reports wait, and what remembers what has been reported (default with --server: beside the log)",
    )
    _add_wait(drive, "for the map and for the last reports")
    drive.add_argument("--seed", type=_count, default=0, metavar="N", help="of the filter's random numbers (default 0)")
    drive.add_argument("--particles", type=_count, default=None, metavar="N", help="of the filter (default 100)")
    drive.add_argument(
        "--pace",
        type=_pace,
        default=None,
        metavar="X",
        help="drive the log at X times the speed at which it was recorded (default: as fast as it can be read)",
    )
    drive.set_defaults(run=_drive)

    fetch = _command(
        actions,
        "fetch-map",
        "fetch an HD map from the server",
        "Fetch a map, with the candidate features that vehicles are asked to watch, into a GeoJSON file. Run again, it "
        "transfers only what has changed; without a connection it keeps the copy that is there.",
    )
    _add_server(fetch, required=True)
    fetch.add_argument("--map", type=_text, required=True, metavar="NAME", help="the map's name on the server")
    fetch.add_argument("--out", type=Path, required=True, metavar="FILE", help="the file to write, or to renew")
    fetch.add_argument(
        "--bbox",
        type=_bbox,
        metavar="W,S,E,N",
        help="only this part, in degrees; west greater than east crosses the antimeridian; write "
        "--bbox=-3.5,40.1,-3.4,40.2 if it begins with a minus",
    )
    fetch.set_defaults(run=_fetch_map)

    upload = _command(
        actions,
        "upload",
        "send what waits in an outbox",
        "Send the reports that wait in an outbox. It can be interrupted and run again at any time: the server takes "
        "each report once.",
    )
    upload.add_argument("--outbox", type=Path, required=True, metavar="FILE", help="the outbox of an earlier drive")
    _add_server(upload, required=True)
    _add_wait(upload, "in all")
    upload.set_defaults(run=_upload)
    return parser


def _command(
    actions: argparse._SubParsersAction[argparse.ArgumentParser], name: str, summary: str, description: str
) -> argparse.ArgumentParser:
    command = actions.add_parser(
        name,
        help=summary,
        description=textwrap.fill(description, 100),
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("-v", "--verbose", action="store_true", help="tell what happens on the way")
    command.set_defaults(usage=command.error)
    return command


def _add_server(command: argparse.ArgumentParser, *, required: bool) -> None:
    command.add_argument("--server", required=required, metavar="URL", help="the slamcu server, as https://host[:port]")
    command.add_argument(
        "--api-key",
        metavar="KEY",
        help=f"the vehicle's key (better in {_KEY_VARIABLE}, which others cannot read)",
    )


def _add_wait(command: argparse.ArgumentParser, what_for: str) -> None:
    command.add_argument(
        "--wait",
        type=_seconds,
        default=60.0,
        metavar="S",
        help=f"seconds to go on trying if the server does not answer, {what_for} (default 60)",
    )


def _text(text: str) -> str:
    if not text.isprintable():
        raise argparse.ArgumentTypeError(f"{text!r} is not printable UTF-8 text")
    return text


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0")
    return int(text)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds from 0 to 1000000")
    return value


def _pace(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return value


def _bbox(text: str) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not four numbers with commas between them") from None
    if not (-180.0 <= west <= 180.0 and -180.0 <= east <= 180.0 and -90.0 <= south <= north <= 90.0):
        raise argparse.ArgumentTypeError("expected west and east in [-180, 180], and south <= north in [-90, 90]")
    return west, south, east, north
