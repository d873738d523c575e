"""Drive logs: what is written is read, record by record, in either frame."""

import io
import itertools
import json
import math
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.catalogue import SIGN_TYPES
from slamcu_core.drive import (
    Detection,
    DetectionFrame,
    DriveHeader,
    GnssFix,
    InitialPose,
    Mount,
    ObjectFrame,
    Occluder,
    Odometry,
    Record,
    Sensor,
    SensorKind,
)
from slamcu_core.formats import read_drive_log, write_drive_log
from slamcu_core.geometry import LocalFrame

texts = st.text(st.characters(codec="utf-8", categories=("L", "N", "P")), min_size=1, max_size=20)
speeds, yaw_rates, places = st.floats(-150.0, 150.0), st.floats(-10.0, 10.0), st.floats(-1e4, 1e4)
positive = st.floats(1e-3, 1e3)
longitudes, latitudes = st.floats(-180.0, 180.0), st.floats(-90.0, 90.0)
headings = st.floats(-360.0, 360.0)
bearings = st.floats(-math.pi, math.pi)
lambdas = st.floats(1e-6, 1.0)
signs = st.none() | st.sampled_from(sorted(SIGN_TYPES))


@st.composite
def sensors(draw: st.DrawFn, name: str, kind: SensorKind) -> Sensor:
    nearest = draw(st.floats(0.0, 10.0))
    return Sensor(
        id=name,
        kind=kind,
        fov_deg=draw(st.floats(1.0, 360.0)),
        min_range_m=nearest,
        max_range_m=nearest + draw(st.floats(0.1, 1e3)),
        rate_hz=draw(positive),
        mount=Mount(draw(st.floats(-9.0, 9.0)), draw(st.floats(-9.0, 9.0)), draw(headings)),
        range_std_m=draw(positive),
        range_std_rel=draw(st.floats(0.0, 1.0)),
        bearing_std_rad=draw(st.floats(1e-3, 9.0)),
        position_std_m=draw(positive),
        detection_probability=draw(lambdas),
        false_alarms_per_frame=draw(st.floats(0.0, 9.0)),
        classes=tuple(draw(st.lists(texts, max_size=3))),
    )


headers = st.builds(
    DriveHeader,
    vehicle_id=texts,
    session_id=texts,
    start_time=st.datetimes(timezones=st.sampled_from([UTC, timezone(timedelta(hours=5, minutes=30))])),
    initial_pose=st.builds(
        InitialPose, longitudes, latitudes, headings, st.floats(0.0, 9.0), heading_std_deg=st.floats(0.0, 9.0)
    ),
    sensors=st.tuples(sensors("camera", SensorKind.RANGE_BEARING), sensors("lidar", SensorKind.POSITION)),
    fleet_id=texts | st.just(""),
    wheelbase_m=st.floats(0.1, 100.0),
)
seen_by_camera = st.builds(
    Detection,
    feature_class=st.just("traffic_sign"),
    range=positive,
    bearing=bearings,
    sign=signs,
    value=st.none() | texts,
    confidence=lambdas,
)
seen_by_lidar = st.builds(
    Detection,
    feature_class=texts.filter(lambda name: name != "traffic_sign"),
    x=places,
    y=places,
    sign=st.none() | texts,
)
times = st.just(0.0)
record_at_zero: st.SearchStrategy[Record] = st.one_of(
    st.builds(Odometry, times, speeds, yaw_rates),
    st.builds(Odometry, times, st.floats(-1.0, 1.0), st.none(), st.floats(-0.05, 0.05)),
    st.builds(GnssFix, times, longitudes, latitudes, positive),
    st.builds(DetectionFrame, times, st.just("camera"), st.lists(seen_by_camera, max_size=3).map(tuple)),
    st.builds(DetectionFrame, times, st.just("lidar"), st.lists(seen_by_lidar, max_size=3).map(tuple)),
    st.builds(
        ObjectFrame,
        times,
        st.sampled_from(["camera", "lidar"]),
        st.lists(st.builds(Occluder, positive, bearings, st.floats(0.0, 9.0), texts), max_size=2).map(tuple),
    ),
)


def lines_of(*documents: dict[str, Any]) -> list[str]:
    return [json.dumps(document) for document in documents]


@given(header=headers, records=st.lists(record_at_zero, max_size=5))
def test_what_is_written_is_read(header: DriveHeader, records: list[Record]) -> None:
    lines = list(write_drive_log(header, records))

    read_header, read_records = read_drive_log(lines)

    assert read_header == header
    assert list(read_records) == records
    assert all(line.endswith("\n") and line.count("\n") == 1 for line in lines)


def test_the_documented_example_is_read(header: dict[str, Any], records: list[dict[str, Any]]) -> None:
    read_header, stream = read_drive_log(lines_of(header, *records))
    read = list(stream)

    assert read_header.start_time == datetime(2026, 5, 1, 8, tzinfo=UTC)
    assert read_header.sensors[0].mount == Mount(1.8, 0.0, 0.0)
    assert read_header.sensors[1] == Sensor("lidar", SensorKind.POSITION, classes=("pole",))
    assert read[0] == Odometry(0.02, 27.8, yaw_rate=0.0012)
    assert read[2] == DetectionFrame(
        0.07,
        "front_camera",
        (Detection("traffic_sign", 35.2, 0.051, sign="SPEED_LIMIT", value="80", confidence=0.93),),
    )
    assert read[4] == DetectionFrame(0.08, "lidar", (Detection("pole", x=3.0, y=-1.5),))
    assert read[5] == DetectionFrame(0.10, "front_camera", ())
    assert read[6] == GnssFix(1.0, 2.1003, 48.9001, 2.5)


def test_bytes_text_and_open_files_are_all_lines(header: dict[str, Any], records: list[dict[str, Any]]) -> None:
    text = "\n".join(lines_of(header, *records)) + "\n\n"
    expected = list(read_drive_log(text.splitlines())[1])

    assert list(read_drive_log(io.StringIO(text))[1]) == expected
    assert list(read_drive_log(io.BytesIO(text.encode()))[1]) == expected
    assert list(read_drive_log(io.BytesIO(b"\xef\xbb\xbf" + text.encode()))[1]) == expected


def test_records_are_read_when_they_are_asked_for(header: dict[str, Any]) -> None:
    def endless() -> Iterator[str]:
        yield json.dumps(header)
        for tick in itertools.count():
            yield json.dumps({"t": tick, "type": "odometry", "speed": 1.0, "yaw_rate": 0.0})

    _, records = read_drive_log(endless())

    assert [record.t for record in itertools.islice(records, 3)] == [0.0, 1.0, 2.0]


def test_what_is_not_known_is_passed_over(header: dict[str, Any], records: list[dict[str, Any]]) -> None:
    expected = list(read_drive_log(lines_of(header, *records))[1])
    for document in (header, *records):
        document["remark"] = {"any": [1, None]}
    wipers = {"t": -5, "type": "wipers", "on": True}

    assert list(read_drive_log(lines_of(header, wipers, *records, wipers))[1]) == expected


def test_certainty_is_legal_and_an_unknown_sign_is_none(header: dict[str, Any], records: list[dict[str, Any]]) -> None:
    records[2]["items"][0] |= {"confidence": 1, "sign": "UNKNOWN_TYPE"}

    (frame,) = read_drive_log(lines_of(header, records[2]))[1]

    assert isinstance(frame, DetectionFrame)
    assert (frame.items[0].confidence, frame.items[0].sign) == (1.0, None)


@pytest.mark.parametrize(
    ("heading", "east", "north"),
    [(90.0, 100.0, 50.0), (0.0, -50.0, 100.0), (180.0, 50.0, -100.0), (270.0, -100.0, -50.0)],
)
def test_a_local_frame_is_turned_into_longitude_and_latitude(
    header: dict[str, Any], heading: float, east: float, north: float
) -> None:
    header["frame"] = {"local": {"lon": 2.0, "lat": 48.0, "heading_deg": heading}}
    header["initial_pose"] = {"x": 0.0, "y": 0.0, "heading_deg": 12.0}
    fix = {"t": 0, "type": "gnss", "x": 100.0, "y": 50.0, "std_m": 2.0}

    read_header, records = read_drive_log(lines_of(header, fix))
    (gnss,) = records

    assert isinstance(gnss, GnssFix)
    assert LocalFrame(2.0, 48.0).to_local(gnss.lon, gnss.lat) == pytest.approx([east, north], abs=1e-6)
    pose = read_header.initial_pose
    assert (pose.lon, pose.lat) == pytest.approx((2.0, 48.0))
    assert (pose.heading_deg, pose.position_std_m, pose.heading_std_deg) == (12.0, 1.5, 2.0)
