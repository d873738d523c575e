"""A small made-up recording in the file format of UTIAS MRCLAM: the real one is not ours to pass on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

BARCODES = {1: 5, 2: 14, 3: 41, 4: 32, 5: 23} | {subject: 100 + 3 * subject for subject in range(6, 21)}
START = 1_248_272_263.5
HEADER = "# made up\n# for a test\n"


def _write_robot(folder: Path, robot: int, landmarks: np.ndarray, duration: float, rng: np.random.Generator) -> None:
    times = START + np.arange(0.0, duration + 1.0, 0.02)
    radius, speed = 1.2 + 0.3 * robot, 0.12
    turn = speed / radius
    phase = 2.0 * np.pi * robot / 5 + turn * (times - START)
    x, y, heading = radius * np.cos(phase), radius * np.sin(phase), phase + np.pi / 2
    with (folder / f"Robot{robot}_Odometry.dat").open("w") as out:
        out.write(HEADER)
        out.writelines(f"{t:.3f}\t {speed:.4f} \t {turn:.5f}\n" for t in times)
    with (folder / f"Robot{robot}_Reference.csv").open("w") as out:
        out.write("time_s,x_m,y_m,heading_rad\n")
        out.writelines(f"{t:.3f},{a:.4f},{b:.4f},{c:.5f}\n" for t, a, b, c in zip(times, x, y, heading, strict=True))
    with (folder / f"Robot{robot}_Measurement.dat").open("w") as out:
        out.write(HEADER)
        for k in range(0, len(times), 12):
            delta = landmarks - (x[k], y[k])
            distance = np.hypot(*delta.T)
            bearing = (np.arctan2(delta[:, 1], delta[:, 0]) - heading[k] + np.pi) % (2 * np.pi) - np.pi
            for i in np.flatnonzero((np.abs(bearing) < 0.55) & (distance > 0.9) & (distance < 6.0)):
                if rng.random() < 0.7:
                    r = distance[i] + rng.normal(0, 0.03 + 0.02 * distance[i])
                    b = bearing[i] + rng.normal(0, 0.01)
                    out.write(f"{times[k]:.3f}\t {BARCODES[int(i) + 6]} \t {r:.3f} \t {b:.4f}\n")
            if k % 96 == 0:  # now and then another robot, in a line of its own a millisecond later
                out.write(f"{times[k] + 0.001:.3f}\t {BARCODES[robot % 5 + 1]} \t 2.000 \t 0.1000\n")


@pytest.fixture(scope="session")
def make_recording() -> Callable[..., Path]:
    def make(directory: Path, *, session: int = 2, robots: int = 5, duration: float = 60.0) -> Path:
        rng = np.random.default_rng(session)
        folder = directory / f"MRCLAM_Dataset{session}"
        folder.mkdir(parents=True)
        angle = np.linspace(0.0, 2.0 * np.pi, 15, endpoint=False)
        landmarks = np.stack([4.0 * np.cos(angle), 4.0 * np.sin(angle)], axis=1) + rng.normal(0, 0.3, (15, 2))
        rows = [f"{subject}\t {code}\n" for subject, code in BARCODES.items()]
        (folder / "Barcodes.dat").write_text(HEADER + "".join(rows))
        marks = [f" {i + 6} \t {x:.8f} \t {y:.8f} \t 0.0001 \t 0.0002\n" for i, (x, y) in enumerate(landmarks)]
        (folder / "Landmark_Groundtruth.dat").write_text(HEADER + "".join(marks))
        for robot in range(1, robots + 1):
            _write_robot(folder, robot, landmarks, duration, rng)
        return directory

    return make


@pytest.fixture(scope="session")
def recording(make_recording: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_recording(tmp_path_factory.mktemp("mrclam"))
