"""A robot's recording as a drive: the header and records that the filter takes from any vehicle.

The arena's x and y are metres east and north of longitude 0, latitude 0.

What the camera did while nothing was recorded has to be inferred, since frames without a detection are not recorded.
Measured on sessions 2 and 4 against the reference trajectories, over the instants at which a frame was due: gaps of up
to about a second are as frequent with one landmark in view (13 %) as with five (11 %) or none (8 %), so they are frames
that were lost, and say nothing. Longer gaps are ten times as frequent with no landmark in view (48 %) as with one
(5 %): there the camera looked and saw nothing. So long gaps become empty frames and short ones stay gaps.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, InitialPose, Mount, Odometry, Record, Sensor
from slamcu_core.errors import FormatError
from slamcu_core.geometry import LocalFrame, math_to_compass
from slamcu_eval.mrclam.files import (
    ROBOTS,
    Sighting,
    read_barcodes,
    read_odometry,
    read_reference,
    read_sightings,
    session_folder,
)

ARENA = LocalFrame(0.0, 0.0)
LANDMARK_CLASS = "pole"
CAMERA = "camera"


@dataclass(frozen=True, slots=True)
class RunParameters:
    """How a recording is turned into a drive."""

    start_position_std_m: float = 0.15  # m each axis, the setting of the evaluation
    start_heading_std_rad: float = 0.08  # rad, the setting of the evaluation
    odometry_period_s: float = 0.1  # s; commands come at 67 Hz, their integral is kept at this step
    same_frame_s: float = 0.05  # s; lines of one camera frame differ by a few ms, frames by 0.24 s (measured)
    frame_rate_hz: float = 4.2  # Hz, the camera's rate (measured: 0.237 s between frames)
    silence_s: float = 1.2  # s; a longer gap between frames holds empty frames (measured, see above); inf: never
    range_std_m: float = 0.08  # m at no distance (measured)
    range_std_rel: float = 0.03  # per m of range (measured)
    bearing_std_rad: float = 0.025  # rad (measured 0.01 to 0.03, heavy tails)
    detection_probability: float = 0.45  # of a landmark in view, per frame (measured 0.3 to 0.6 at 1 to 5 m)
    false_alarms_per_frame: float = 0.005  # misread barcodes (measured: about 0.001, and range outliers)
    max_range_m: float = 7.0  # m, beyond it detections are rare (measured)
    confidence: float = 0.9  # λ of eq. 1, as in the paper


def load_run(
    directory: Path | str,
    session: int,
    robot: int,
    duration: float,
    *,
    begin: float = 0.0,
    rng: np.random.Generator | None = None,
    parameters: RunParameters | None = None,
) -> tuple[DriveHeader, list[Record], NDArray[np.float64]]:
    """Load `duration` seconds of one robot's run, from `begin` s into it, as a drive.

    Time 0 is the first pose of the reference trajectory from there on. Barcodes are used for one thing only:
    detections of other robots are dropped by class. They leave a frame behind, for they prove that the camera looked.

    Parameters
    ----------
    directory : the folder that holds ``MRCLAM_DatasetN``.
    rng : draws the error of the start pose; by default one that depends on session and robot only.

    Returns
    -------
    The header, the records in order of time, and the reference trajectory (T, 4): time since the start in s, x and y in
    m, heading in rad.

    Raises FormatError naming file and line, MissingRecordingError if the recording is not there.
    """
    p = parameters or RunParameters()
    rng = np.random.default_rng((session, robot)) if rng is None else rng
    folder = session_folder(Path(directory), session)
    reference = read_reference(folder, robot, begin)
    start = float(reference[0, 0])
    reference[:, 0] -= start
    subjects = read_barcodes(folder)
    sightings = list(read_sightings(folder, robot))
    if not sightings:
        raise FormatError("expected at least one measurement, found none", source=f"Robot{robot}_Measurement.dat")
    camera = camera_of(sightings, p)
    header = DriveHeader(
        vehicle_id=f"robot-{robot}",
        session_id=f"mrclam-{session}-robot-{robot}",
        start_time=datetime.fromtimestamp(start, UTC),
        initial_pose=_start_pose(reference[0, 1:], rng, p),
        sensors=(camera,),
        fleet_id=f"mrclam-{session}",
    )
    within = takewhile(lambda s: s.time <= start + duration, (s for s in sightings if s.time >= start))
    frames = with_silent_frames(_frames(within, subjects, start, float(np.deg2rad(camera.mount.yaw_deg)), p), p)
    steps = list(_odometry(read_odometry(folder, robot), start, duration, p.odometry_period_s))
    records: list[Record] = sorted([*steps, *frames], key=lambda record: record.t)
    return header, records, reference[reference[:, 0] <= duration]


def camera_of(sightings: Iterable[Sighting], parameters: RunParameters) -> Sensor:
    """Describe a robot's camera by how its own sightings spread.

    The cameras are not mounted alike: one looks from -0.58 to 0.48 rad, another from -0.30 to 0.57. The edges of what
    a camera ever saw are a property of the robot, as its maker would state it, and need no landmark's identity.
    """
    polar = np.array([(s.range, s.bearing) for s in sightings], float)
    right, left = np.quantile(polar[:, 1], (0.005, 0.995))
    return Sensor(
        id=CAMERA,
        fov_deg=float(np.rad2deg(left - right)),
        mount=Mount(yaw_deg=float(np.rad2deg(left + right) / 2.0)),
        min_range_m=float(np.quantile(polar[:, 0], 0.005)),
        max_range_m=parameters.max_range_m,
        rate_hz=parameters.frame_rate_hz,
        range_std_m=parameters.range_std_m,
        range_std_rel=parameters.range_std_rel,
        bearing_std_rad=parameters.bearing_std_rad,
        detection_probability=parameters.detection_probability,
        false_alarms_per_frame=parameters.false_alarms_per_frame,
        classes=(LANDMARK_CLASS,),
    )


def with_silent_frames(frames: Iterable[DetectionFrame], parameters: RunParameters) -> Iterator[DetectionFrame]:
    """Put empty frames, at the camera's rate, into the gaps that are too long to be frames that were lost."""
    before: float | None = None
    for frame in frames:
        if before is not None and frame.t - before > parameters.silence_s:
            silent = round((frame.t - before) * parameters.frame_rate_hz) - 1
            for t in np.linspace(before, frame.t, silent + 2)[1:-1].tolist():
                yield DetectionFrame(round(t, 6), CAMERA)
        yield frame
        before = frame.t


def _start_pose(pose: NDArray[np.float64], rng: np.random.Generator, p: RunParameters) -> InitialPose:
    lon, lat = ARENA.to_geographic(pose[:2] + rng.normal(0.0, p.start_position_std_m, 2))
    heading = float(pose[2]) + rng.normal(0.0, p.start_heading_std_rad)
    return InitialPose(
        float(lon),
        float(lat),
        math_to_compass(heading),
        position_std_m=p.start_position_std_m,
        heading_std_deg=float(np.rad2deg(p.start_heading_std_rad)),
    )


def _frames(
    sightings: Iterable[Sighting], subjects: dict[int, int], start: float, axis: float, p: RunParameters
) -> Iterator[DetectionFrame]:
    """Group sightings into camera frames; a frame of which only robots remain is an empty look."""
    group: list[Sighting] = []
    for sighting in sightings:
        if group and sighting.time - group[0].time > p.same_frame_s:
            yield _frame(group, subjects, start, axis, p)
            group = []
        group.append(sighting)
    if group:
        yield _frame(group, subjects, start, axis, p)


def _frame(
    group: list[Sighting], subjects: dict[int, int], start: float, axis: float, p: RunParameters
) -> DetectionFrame:
    items = tuple(
        Detection(LANDMARK_CLASS, range=s.range, bearing=s.bearing - axis, confidence=p.confidence)
        for s in group
        if subjects.get(s.barcode) not in ROBOTS
    )
    return DetectionFrame(round(group[0].time - start, 6), CAMERA, items)


def _odometry(
    commands: Iterable[tuple[float, float, float]], start: float, duration: float, period: float
) -> Iterator[Odometry]:
    """Thin commands to one per period: the mean over each period of what held, so that way and turn are kept."""
    rows = np.array(list(takewhile(lambda row: row[0] <= start + duration, commands)), float).reshape(-1, 3)
    if not len(rows):
        return
    times = rows[:, 0] - start
    edges = np.arange(0.0, duration + period, period)
    held = np.diff(times, append=max(float(times[-1]), duration) + period)
    way = np.vstack([np.zeros(2), np.cumsum(rows[:, 1:] * held[:, None], axis=0)])
    knots = np.append(times, times[-1] + held[-1])
    for column_free in zip(edges[:-1], *(np.diff(np.interp(edges, knots, w)) / period for w in way.T), strict=True):
        t, speed, yaw_rate = map(float, column_free)
        yield Odometry(round(t, 6), speed, yaw_rate=yaw_rate)
