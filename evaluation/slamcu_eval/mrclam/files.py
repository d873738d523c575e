"""The files of a UTIAS MRCLAM recording, read line by line.

Leung, Halpern, Barfoot, Liu: "The UTIAS multi-robot cooperative localization and mapping dataset", IJRR 2011.
A session is a folder ``MRCLAM_DatasetN`` with ``Barcodes.dat``, ``Landmark_Groundtruth.dat`` and, per robot,
``_Odometry.dat``, ``_Measurement.dat`` and ``_Groundtruth.dat``; a ``RobotN_Reference.csv`` stands for the last.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamcu_core.errors import FormatError

ROBOTS = (1, 2, 3, 4, 5)  # subjects 1 to 5 are the robots, the rest are landmarks
WHERE_TO_GET = (
    "The recordings are not part of slamcu. Get the UTIAS MRCLAM dataset (Multi-Robot Cooperative Localization and "
    "Mapping) from the Autonomous Space Robotics Lab of the University of Toronto, for educational use, and unpack "
    "it so that the folder holds MRCLAM_Dataset1, MRCLAM_Dataset2, … each with Barcodes.dat, Landmark_Groundtruth.dat, "
    "RobotN_Odometry.dat, RobotN_Measurement.dat and RobotN_Groundtruth.dat, or in place of the last "
    "RobotN_Reference.csv (time_s, x_m, y_m, heading_rad)."
)


class MissingRecordingError(FormatError):
    """A recorded session, or a file of it, is not there; says where to get it."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"not found. {WHERE_TO_GET}", source=str(path))


@dataclass(frozen=True, slots=True)
class Landmark:
    """A surveyed landmark of the arena."""

    subject: int
    x: float  # m
    y: float  # m


@dataclass(frozen=True, slots=True)
class Sighting:
    """One line of a measurement file: a barcode at a range and bearing."""

    time: float  # s, UNIX time
    barcode: int
    range: float  # m
    bearing: float  # rad, counter-clockwise from the robot's heading


def session_folder(directory: Path, session: int) -> Path:
    """Return the folder of a recorded session; raise MissingRecordingError if there is none."""
    folder = directory / f"MRCLAM_Dataset{session}"
    if not folder.is_dir():
        raise MissingRecordingError(folder)
    return folder


def read_barcodes(folder: Path) -> dict[int, int]:
    """Read which subject wears which barcode: {barcode: subject}."""
    path = folder / "Barcodes.dat"
    subjects: dict[int, int] = {}
    for line, (subject, barcode) in _rows(path, ("subject", "barcode")):
        number = _whole(barcode, path, line, "barcode")
        if number in subjects:
            raise FormatError(f"barcode {number} is given twice", source=path.name, line=line, field="barcode")
        subjects[number] = _whole(subject, path, line, "subject")
    return subjects


def read_landmarks(folder: Path) -> tuple[Landmark, ...]:
    """Read the surveyed landmarks, in the order of the file."""
    path = folder / "Landmark_Groundtruth.dat"
    rows = _rows(path, ("subject", "x", "y", "x std", "y std"))
    return tuple(Landmark(_whole(row[0], path, line, "subject"), row[1], row[2]) for line, row in rows)


def read_sightings(folder: Path, robot: int) -> Iterator[Sighting]:
    """Stream the measurements of a robot in order of time."""
    path = folder / f"Robot{robot}_Measurement.dat"
    for line, (time, barcode, distance, bearing) in _ordered(path, ("time", "barcode", "range", "bearing")):
        if distance <= 0.0:
            raise FormatError(
                f"expected a range above 0 m, got {distance:g}", source=path.name, line=line, field="range"
            )
        yield Sighting(time, _whole(barcode, path, line, "barcode"), distance, bearing)


def read_odometry(folder: Path, robot: int) -> Iterator[tuple[float, float, float]]:
    """Stream the commands of a robot in order of time: UNIX time in s, speed in m/s, yaw rate in rad/s."""
    for _, (time, speed, yaw_rate) in _ordered(folder / f"Robot{robot}_Odometry.dat", ("time", "speed", "yaw rate")):
        yield time, speed, yaw_rate


def read_reference(folder: Path, robot: int, begin: float = 0.0) -> NDArray[np.float64]:
    """Read the trajectory that a robot is scored by, from `begin` s after its first pose on.

    Returns (T, 4): UNIX time in s, x and y in m, heading in rad. Raises FormatError if no pose is left.

    That is `RobotN_Reference.csv` where there is one, else the dataset's own `RobotN_Groundtruth.dat`.
    """
    path = folder / f"Robot{robot}_Reference.csv"
    if not path.exists():
        path = path.with_name(f"Robot{robot}_Groundtruth.dat")
    separator = "," if path.suffix == ".csv" else None
    rows = [row for _, row in _ordered(path, ("time_s", "x_m", "y_m", "heading_rad"), separator=separator)]
    if not rows:
        raise FormatError("expected at least one pose, found none", source=path.name)
    poses = np.array(rows, float)
    lasts = poses[-1, 0] - poses[0, 0]
    if begin > lasts:
        raise FormatError(
            f"expected poses {begin:g} s after the first, but it ends after {lasts:.0f} s", source=path.name
        )
    return poses[int(np.searchsorted(poses[:, 0], poses[0, 0] + begin)) :]


def _ordered(
    path: Path, fields: tuple[str, ...], separator: str | None = None
) -> Iterator[tuple[int, tuple[float, ...]]]:
    """Pass on the rows of a file whose first column is the time; raise FormatError where the time runs backwards."""
    before = -math.inf
    for line, row in _rows(path, fields, separator):
        if row[0] < before:
            raise FormatError(
                f"time runs backwards, from {before:.3f} to {row[0]:.3f}", source=path.name, line=line, field=fields[0]
            )
        before = row[0]
        yield line, row


def _rows(path: Path, fields: tuple[str, ...], separator: str | None = None) -> Iterator[tuple[int, tuple[float, ...]]]:
    """Yield (line number, values) of every data line, past comments, blank lines and a first line of names."""
    try:
        stream = path.open(encoding="utf-8")
    except FileNotFoundError:
        raise MissingRecordingError(path) from None
    with stream:
        for line, text in enumerate(stream, 1):
            parts = [part.strip() for part in text.split("#", 1)[0].split(separator)]
            if not any(parts) or (line == 1 and tuple(parts) == fields):
                continue
            if len(parts) != len(fields):
                raise FormatError(
                    f"expected {len(fields)} columns ({', '.join(fields)}), found {len(parts)}",
                    source=path.name,
                    line=line,
                )
            values = tuple(_number(part, path, line, name) for part, name in zip(parts, fields, strict=True))
            yield line, values


def _number(text: str, path: Path, line: int, name: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FormatError(f"expected a finite number, got {text!r}", source=path.name, line=line, field=name)
    return value


def _whole(value: float, path: Path, line: int, name: str) -> int:
    if value != int(value):
        raise FormatError(f"expected a whole number, got {value:g}", source=path.name, line=line, field=name)
    return int(value)
