from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from slamcu_core.errors import FormatError
from slamcu_eval.mrclam.files import (
    MissingRecordingError,
    read_barcodes,
    read_landmarks,
    read_odometry,
    read_reference,
    read_sightings,
    session_folder,
)


def test_a_recording_is_read_past_its_comments(recording: Path) -> None:
    folder = session_folder(recording, 2)
    assert read_barcodes(folder)[5] == 1
    assert [mark.subject for mark in read_landmarks(folder)] == list(range(6, 21))
    assert read_reference(folder, 1).shape[1] == 4
    assert next(read_sightings(folder, 1)).range > 0
    assert next(iter(read_odometry(folder, 1)))[1] == pytest.approx(0.12)


def test_a_missing_session_says_where_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(MissingRecordingError, match=r"MRCLAM_Dataset7.*University of Toronto.*educational"):
        session_folder(tmp_path, 7)


def test_a_missing_file_says_where_to_get_it(make_recording: Callable[..., Path], tmp_path: Path) -> None:
    folder = make_recording(tmp_path, robots=1, duration=5.0) / "MRCLAM_Dataset2"
    with pytest.raises(MissingRecordingError, match="Robot4_Odometry"):
        list(read_odometry(folder, 4))


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("Robot1_Measurement.dat", "# c\n1.0 5 2.0 0.1\n1.1 5 x 0.1\n", "Measurement.dat, line 3, field range.*'x'"),
        ("Robot1_Measurement.dat", "# c\n1.0 5 2.0\n", "line 2: expected 4 columns"),
        ("Robot1_Measurement.dat", "1.0 5 2.0 nan\n", "line 1, field bearing: expected a finite number"),
        ("Robot1_Measurement.dat", "1.0 5.5 2.0 0.1\n", "line 1, field barcode: expected a whole number"),
        ("Robot1_Measurement.dat", "1.0 5 -2.0 0.1\n", "line 1, field range: expected a range above 0"),
        ("Robot1_Measurement.dat", "2.0 5 2.0 0.1\n1.0 5 2.0 0.1\n", "line 2, field time: time runs backwards"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, name: str, text: str, complaint: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=complaint):
        list(read_sightings(tmp_path, 1))


def test_a_barcode_worn_twice_is_refused(tmp_path: Path) -> None:
    (tmp_path / "Barcodes.dat").write_text("1 5\n2 5\n")
    with pytest.raises(FormatError, match="line 2, field barcode: barcode 5 is given twice"):
        read_barcodes(tmp_path)


def test_without_a_reference_the_published_ground_truth_is_read(tmp_path: Path) -> None:
    (tmp_path / "Robot1_Groundtruth.dat").write_text("# time x y heading\n10.0  1.5 -2.5  0.1\n10.01  1.6 -2.5  0.2\n")
    assert read_reference(tmp_path, 1).tolist() == [[10.0, 1.5, -2.5, 0.1], [10.01, 1.6, -2.5, 0.2]]
    (tmp_path / "Robot1_Groundtruth.dat").unlink()
    with pytest.raises(MissingRecordingError, match=r"Groundtruth\.dat"):
        read_reference(tmp_path, 1)


def test_an_empty_reference_is_refused(tmp_path: Path) -> None:
    (tmp_path / "Robot1_Reference.csv").write_text("time_s,x_m,y_m,heading_rad\n")
    with pytest.raises(FormatError, match="at least one pose"):
        read_reference(tmp_path, 1)
