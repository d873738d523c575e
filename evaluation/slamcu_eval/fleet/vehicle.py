"""One vehicle of a fleet: it fetches the map, drives with the real session, and uploads what it saw."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from slamcu_client import Server, Uploader, UploadResult, VehicleSession
from slamcu_client.map_cache import MapCache
from slamcu_core.drive import DetectionFrame, DriveHeader, Record
from slamcu_core.errors import SlamcuError
from slamcu_core.filter import FeatureEstimate, FilterParameters
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap
from slamcu_core.reports import Health, ReportMessage
from slamcu_eval.fleet.witness import WitnessedOutbox

Array = NDArray[np.float64]

_UPLOAD_TIMEOUT_S = 120.0
_TELL_EVERY = 0.01  # share of the drive between two reports of progress
_POSES_HZ = 2.0  # how often the pose is compared with the truth


@dataclass(frozen=True, slots=True)
class OpenDrive:
    """A drive that is ready to be fed, and where the vehicle truly was."""

    header: DriveHeader
    records: Sequence[Record]
    truth: Array  # (K, 3): s since the start, longitude and latitude in degrees


class DriveSource(Protocol):
    """Where a drive comes from; it travels to the vehicle's process, so it names the data instead of holding it."""

    def open(self) -> OpenDrive:
        """Load or simulate the drive."""


@dataclass(frozen=True, slots=True)
class Account:
    """A vehicle's place in the cloud: the server, its key, and a folder for its outbox and map cache."""

    url: str
    key: str
    folder: Path


@dataclass(frozen=True, slots=True)
class VehicleJob:
    """What one vehicle is to do."""

    drive: DriveSource
    seed: int  # of its filter
    hd_map: HDMap  # as it is when the vehicle sets out
    account: Account | None = None  # None: it drives alone and reports to nobody
    parameters: FilterParameters | None = None


@dataclass(frozen=True, slots=True)
class VehicleOutcome:
    """What became of it."""

    start_time: datetime  # aware; the instant of t = 0
    features: tuple[FeatureEstimate, ...]
    pose_t: Array  # (K,) s since the start
    pose_errors_m: Array  # (K,) distance from the truth, a few times a second
    step_ms: Array  # (F,) per detection frame, the odometry since the frame before included
    passes: int  # that it reported, or would have
    upload: UploadResult | None
    health: Health
    messages: tuple[ReportMessage, ...] = ()  # that went through its outbox, in order

    @property
    def pose_rmse_m(self) -> float:
        """Root mean square of the pose's distance from the truth."""
        return float(np.sqrt(np.mean(self.pose_errors_m**2))) if self.pose_errors_m.size else float("nan")


def fetch_map(account: Account, name: str) -> HDMap:
    """Fetch a map from the server, as a vehicle does before it sets out.

    Raises SlamcuError if it cannot be had.
    """
    account.folder.mkdir(parents=True, exist_ok=True)
    with Server(account.url, account.key) as server:
        return MapCache(account.folder / f"{name}.geojson", server, name).refresh().hd_map


def drive_vehicle(job: VehicleJob, tell: Callable[[float], None] = lambda _: None) -> VehicleOutcome:
    """Let one vehicle drive, and upload its reports while it does.

    Parameters
    ----------
    tell : called now and then with the share of the drive that is done, up to 1.

    Raises SlamcuError if a message was refused or stays in the outbox.
    """
    drive = job.drive.open()
    if job.account is None:
        with VehicleSession(job.hd_map, drive.header, None, job.parameters, seed=job.seed) as session:
            poses, steps = _feed(session, drive, tell)
        return _outcome(drive, session, poses, steps)
    job.account.folder.mkdir(parents=True, exist_ok=True)
    with (
        Server(job.account.url, job.account.key) as server,
        WitnessedOutbox(job.account.folder / "outbox.sqlite") as outbox,
    ):
        uploader = Uploader(outbox, server, rng=np.random.default_rng(job.seed))
        with (
            uploader.in_background(),
            VehicleSession(job.hd_map, drive.header, outbox, job.parameters, seed=job.seed) as session,
        ):
            poses, steps = _feed(session, drive, tell)
        upload = uploader.flush(_UPLOAD_TIMEOUT_S)
    if upload.remaining or upload.rejected:
        raise SlamcuError(
            f"{drive.header.session_id}: {upload.remaining} messages were not taken, {upload.rejected} were refused"
        )
    return _outcome(drive, session, poses, steps, upload=upload, messages=tuple(outbox.messages))


def _outcome(
    drive: OpenDrive,
    session: VehicleSession,
    poses: tuple[Array, Array],
    steps: Array,
    *,
    upload: UploadResult | None = None,
    messages: tuple[ReportMessage, ...] = (),
) -> VehicleOutcome:
    passes = session.passes if upload is None else session.passes_reported
    start, features = drive.header.start_time, tuple(session.features())
    return VehicleOutcome(start, features, *poses, steps, passes, upload, session.health, messages)


def _feed(
    session: VehicleSession, drive: OpenDrive, tell: Callable[[float], None]
) -> tuple[tuple[Array, Array], Array]:
    """Feed the drive to the session; return times (K,) s and pose errors (K,) m, and the time per frame (F,) in ms."""
    start = drive.header.initial_pose
    frame = LocalFrame(start.lon, start.lat)
    true_xy = frame.to_local(drive.truth[:, 1], drive.truth[:, 2])
    poses: list[tuple[float, float, float]] = []
    steps: list[float] = []
    spent, told, next_pose = 0.0, 0.0, 0.0
    for index, record in enumerate(drive.records):
        begun = time.perf_counter()
        session.feed(record)
        spent += time.perf_counter() - begun
        if isinstance(record, DetectionFrame):
            steps.append(1e3 * spent)
            spent = 0.0
            if record.t >= next_pose:
                next_pose = record.t + 1.0 / _POSES_HZ
                pose = session.pose
                poses.append((record.t, pose.lon, pose.lat))
        if (index + 1) / len(drive.records) - told >= _TELL_EVERY:
            told = (index + 1) / len(drive.records)
            tell(told)
    tell(1.0)
    where = np.array(poses, float).reshape(-1, 3)
    errors = frame.to_local(where[:, 1], where[:, 2]) - np.stack(
        [np.interp(where[:, 0], drive.truth[:, 0], true_xy[:, axis]) for axis in (0, 1)], axis=-1
    )
    return (where[:, 0], np.hypot(errors[:, 0], errors[:, 1])), np.array(steps)
