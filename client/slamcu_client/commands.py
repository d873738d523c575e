"""What `slamcu-vehicle` does; `cli` says what it takes."""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path

from slamcu_client.console import Console
from slamcu_client.errors import AnswerError, MapUnavailableError, OutboxError, TransportError
from slamcu_client.files import load_map_file, opened, write_text
from slamcu_client.map_cache import MapCache
from slamcu_client.map_pages import BoundingBox
from slamcu_client.outbox import Outbox
from slamcu_client.progress import ProgressBar
from slamcu_client.results import result_features
from slamcu_client.server import Server
from slamcu_client.session import VehicleSession
from slamcu_client.summary import summary_lines
from slamcu_client.upload_health import UploadResult
from slamcu_client.uploader import Uploader, UploadPolicy
from slamcu_core.drive import DriveHeader
from slamcu_core.errors import SlamcuError
from slamcu_core.filter import FilterParameters
from slamcu_core.formats import read_drive_log, write_results
from slamcu_core.hd_map import HDMap

DONE, LEFT_OVER = 0, 3
console = Console()
_REPORT_EVERY = 64  # records between two looks at the progress
_MAP_RETRY_S = 2.0
# a drive that another outbox has reported is known by its first messages, before more of it counts twice
_CAREFUL = UploadPolicy(feel_ahead=True)


@dataclass(frozen=True, slots=True)
class ServerAddress:
    """Where the server is, and the key to it."""

    url: str
    api_key: str

    def connect(self) -> Server:
        """Return the server; raises ConnectionSettingsError."""
        return Server(self.url, self.api_key)


@dataclass(frozen=True, slots=True)
class DriveOrder:
    """What `drive` is asked to do."""

    log: Path
    map_file: Path | None = None
    map_name: str | None = None
    result: Path | None = None
    outbox: Path | None = None
    seed: int = 0
    particles: int | None = None
    wait_s: float = 60.0
    pace: float | None = None  # times the speed at which the log was recorded; None: as fast as it can be read


def drive(order: DriveOrder, address: ServerAddress | None) -> int:
    """Drive a recorded log; return the exit code. Raises SlamcuError or OSError for what the user must mend."""
    parameters = FilterParameters() if order.particles is None else FilterParameters(particles=order.particles)
    if order.result is not None:
        _check_target(order.result)  # now, not at the end of a long drive
    with ExitStack() as stack:
        server = stack.enter_context(address.connect()) if address else None
        hd_map = _map(order, server)
        outbox_path = order.outbox or (order.log.with_name(f"{order.log.name}.outbox") if server else None)
        if outbox_path is None:
            _drive_log(order, hd_map, parameters, None)
            return DONE
        header = _check_log(order.log)
        outbox = stack.enter_context(Outbox(outbox_path))
        reported_before = outbox.session(header.session_id).closed
        if reported_before:
            console.say("this drive has been reported before: nothing of it is reported again")
        uploader = Uploader(outbox, server, _CAREFUL) if server else None
        try:
            with uploader.in_background() if uploader else nullcontext():
                _drive_log(order, hd_map, parameters, None if reported_before else outbox)
            code = _deliver(uploader, outbox, order.wait_s) if uploader else DONE
        finally:
            waiting = outbox.stats().pending
            if waiting:
                console.say(f"{waiting} messages wait in {outbox_path}: slamcu-vehicle upload sends them")
    return code


def _check_target(path: Path) -> None:
    if not path.parent.is_dir():
        raise SlamcuError(f"{path}: there is no folder {path.parent}")
    if path.is_dir():
        raise SlamcuError(f"{path}: is a folder, and should be a file")


def fetch_map(address: ServerAddress, name: str, out: Path, bbox: BoundingBox | None) -> int:
    """Fetch a map into a file; return the exit code."""
    _check_target(out)
    with address.connect() as server:
        snapshot = MapCache(out, server, name, bbox=bbox).refresh()
    watched = sum(feature.watched for feature in snapshot.hd_map)
    identity = snapshot.hd_map.identity
    console.tell(
        f"{out}: {identity.source} {identity.version}, {len(snapshot.hd_map) - watched} features and {watched} to watch"
    )
    if not snapshot.fresh:
        console.say(f"{snapshot.stale_because}: this is the copy of {snapshot.fetched_at:%Y-%m-%d %H:%M} UTC")
        return LEFT_OVER
    return DONE


def upload(address: ServerAddress, path: Path, wait_s: float) -> int:
    """Send what waits in an outbox; return the exit code."""
    if not path.is_file():
        raise OutboxError(f"{path}: there is no such outbox")
    with address.connect() as server, Outbox(path) as outbox:
        return _deliver(Uploader(outbox, server, _CAREFUL), outbox, wait_s)


def _map(order: DriveOrder, server: Server | None) -> HDMap:
    if order.map_file is not None:
        return load_map_file(order.map_file)
    if server is None or order.map_name is None:
        raise SlamcuError("a map is needed: --map, or --map-name with --server")
    deadline, told = time.monotonic() + order.wait_s, False
    with tempfile.TemporaryDirectory(prefix="slamcu-") as folder:
        cache = MapCache(Path(folder) / "map.geojson", server, order.map_name)
        while True:
            try:
                return cache.refresh().hd_map
            except MapUnavailableError as error:  # no network, or no server that answers: another moment may have both
                why = error.__cause__
                lost = isinstance(why, TransportError | AnswerError)
                if not lost or time.monotonic() + _MAP_RETRY_S > deadline:
                    raise SlamcuError(f"the map {order.map_name} cannot be had: {why or error}") from error
                if not told:
                    console.say(f"no map yet, and asking on for {order.wait_s:g} s: {why}")
                    told = True
            time.sleep(_MAP_RETRY_S)


def _check_log(path: Path) -> DriveHeader:
    """Read the whole log once before any of it is reported: a report cannot be taken back."""
    with opened(path) as file, ProgressBar("checking", file.size) as bar:
        header, records = read_drive_log(file.lines(), source=str(path))
        for index, _ in enumerate(records):
            if index % _REPORT_EVERY == 0:
                bar.update(file.position)
    return header


def _drive_log(order: DriveOrder, hd_map: HDMap, parameters: FilterParameters, outbox: Outbox | None) -> None:
    """Drive the log, write the result and print the summary."""
    with opened(order.log) as file, ProgressBar("driving", file.size) as bar:
        header, records = read_drive_log(file.lines(), source=str(order.log))
        count, seconds = 0, 0.0
        with VehicleSession(hd_map, header, outbox, parameters, seed=order.seed) as session:
            begun = time.monotonic()
            for count, record in enumerate(records, start=1):
                if order.pace is not None:
                    time.sleep(max(0.0, begun + record.t / order.pace - time.monotonic()))
                session.feed(record)
                seconds = record.t
                if count % _REPORT_EVERY == 0:
                    bar.update(file.position, f"{seconds:.0f} s, {session.passes} passes")
    estimates = session.features()
    if order.result is not None:
        write_text(order.result, write_results(result_features(estimates)))
    reported = f", {session.passes_reported} reported" if outbox is not None else ""
    console.tell(f"{header.session_id}: {seconds:.1f} s, {count} records, {session.passes} passes{reported}")
    for line in summary_lines(hd_map, estimates):
        console.tell(line)
    lost = session.passes_dropped + session.passes_unusable
    if lost:
        console.say(f"{lost} passes could not be reported")
    if not session.health.trusted:
        console.say(
            "the filter has lost its way: the reports of this drive are flagged, and its result is not to be trusted"
        )


def _deliver(uploader: Uploader, outbox: Outbox, wait_s: float) -> int:
    result: UploadResult = uploader.flush(wait_s)
    console.tell(
        f"messages: {result.accepted} accepted, {result.duplicates} known already, {result.rejected} rejected, "
        f"{result.remaining} waiting"
    )
    if result.remaining and uploader.health.failing:
        console.say(f"the newest attempt failed: {uploader.health.last_failure}")
        if uploader.health.strangers:
            console.say("a hotspot or a proxy stands in the way, or this is not the server's address")
    for session in sorted(uploader.contradicted):
        console.say(
            f"{session}: the server has other reports of this session, and gets nothing more of it: either the drive "
            "was reported before, against the map as it was then, or another drive has the same session_id"
        )
    refused = outbox.rejected(limit=200) if result.rejected else []
    told = [one for one in refused[: result.rejected] if one.key.session_id not in uploader.contradicted]
    for message in told[:5]:
        console.say(
            f"rejected: message {message.key.message_id} of {message.key.session_id}: {message.reason} {message.detail}"
        )
    return LEFT_OVER if result.remaining or result.rejected else DONE
