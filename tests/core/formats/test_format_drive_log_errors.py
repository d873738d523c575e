"""Drive logs that are wrong: the line, the field and what was expected are named."""

import copy
import json
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slamcu_core.drive import Record
from slamcu_core.errors import FormatError
from slamcu_core.formats import read_drive_log

Json = dict[str, Any]


def refusal(lines: Sequence[str | bytes]) -> FormatError:
    with pytest.raises(FormatError) as caught:
        list(read_drive_log(lines, source="drive.jsonl")[1])
    assert caught.value.source == "drive.jsonl"
    return caught.value


def put(path: str, value: object) -> Callable[[Json], None]:
    """Return what sets (or, with ..., removes) the value at a path such as ``sensors.0.id``."""

    def change(document: Json) -> None:
        *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
        holder: Any = document
        for part in parents:
            holder = holder[part]
        if value is ...:
            del holder[last]
        else:
            holder[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "field", "expected"),
    [
        (put("type", "odometry"), "type", 'expected "header" on the first line'),
        (put("format", "rosbag"), "format", "slamcu-drive-log"),
        (put("version", 2), "version", "expected 1, the only version there is, not 2"),
        (put("version", "1"), "version", "an integer"),
        (put("vehicle_id", ...), "vehicle_id", "but it is missing"),
        (put("session_id", ""), "session_id", "printable text of 1 to 200 characters"),
        (put("session_id", "a\u0000b"), "session_id", "printable"),
        (put("session_id", "\ud800"), "session_id", "printable"),
        (put("start_time", "yesterday"), "start_time", "ISO 8601"),
        (put("start_time", "2026-05-01T08:00:00"), "start_time", "with a time zone"),
        (put("start_time", 1777622400), "start_time", "not 1777622400"),
        (put("frame", "utm"), "frame", 'expected "wgs84" or'),
        (put("frame", {"local": {"lon": 0, "lat": 0}}), "frame.local.heading_deg", "a number"),
        (put("frame", {"local": {"lon": 0, "lat": 91, "heading_deg": 0}}), "frame.local.lat", "from -90 to 90"),
        (put("initial_pose", [1, 2]), "initial_pose", "expected an object, not a list"),
        (put("initial_pose.lon", 181.0), "initial_pose.lon", "from -180 to 180, not 181"),
        (put("initial_pose.heading_deg", True), "initial_pose.heading_deg", "not a boolean"),
        (put("initial_pose.position_std_m", -1), "initial_pose.position_std_m", "a number in [0, 100000] m"),
        (put("wheelbase_m", 0), "wheelbase_m", "above 0"),
        (put("sensors", {}), "sensors", "a list of objects"),
        (put("sensors.1", 3), "sensors[1]", "expected an object, not 3"),
        (put("sensors.1.id", "front_camera"), "sensors[1].id", "two sensors have the id 'front_camera'"),
        (put("sensors.0.kind", "sonar"), "sensors[0].kind", "one of position, range_bearing"),
        (put("sensors.0.fov_deg", 361), "sensors[0].fov_deg", "a number in [1e-06, 360] degrees"),
        (put("sensors.0.max_range_m", 1), "sensors[0].max_range_m", "above min_range_m, 2"),
        (put("sensors.0.rate_hz", 0), "sensors[0].rate_hz", "in [1e-06, 1e+06] Hz"),
        (put("sensors.0.mount.yaw_deg", "left"), "sensors[0].mount.yaw_deg", "a number"),
        (put("sensors.0.mount.x", 101), "sensors[0].mount.x", "a number in [-100, 100] m"),
        (put("sensors.0.range_std_m", -0.1), "sensors[0].range_std_m", "in [0, 1000] m"),
        (put("sensors.0.bearing_std_rad", 0), "sensors[0].bearing_std_rad", "in [1e-06, 10] rad"),
        (put("sensors.0.detection_probability", 1.1), "sensors[0].detection_probability", "in [1e-06, 1]"),
        (put("sensors.0.detection_probability", 0), "sensors[0].detection_probability", "in [1e-06, 1]"),
        (put("sensors.0.false_alarms_per_frame", -1), "sensors[0].false_alarms_per_frame", "in [0, 1000]"),
        (put("sensors.0.classes", ["pole", 7]), "sensors[0].classes.1", "printable text"),
        (put("sensors.0.classes", "pole"), "sensors[0].classes", "a list of text"),
    ],
)
def test_a_fault_in_the_header_is_named(
    header: Json, change: Callable[[Json], None], field: str, expected: str
) -> None:
    change(header)

    error = refusal([json.dumps(header)])

    assert (error.line, error.field) == (1, field)
    assert expected in error.message


def test_a_sensor_without_any_noise_is_refused(header: Json) -> None:
    header["sensors"][0] |= {"range_std_m": 0, "range_std_rel": 0}

    assert refusal([json.dumps(header)]).field == "sensors[0].range_std_m"


def test_a_sensor_that_measures_no_range_needs_no_noise_of_it(header: Json) -> None:
    header["sensors"][0] |= {"kind": "position", "range_std_m": 0, "range_std_rel": 0}

    read_drive_log([json.dumps(header)])


@pytest.mark.parametrize(
    "fault",
    [
        (0, put("type", ...), "type", "but it is missing"),
        (0, put("type", "header"), "type", "a second header"),
        (0, put("t", ...), "t", "expected a number from 0, but it is missing"),
        (0, put("t", -0.1), "t", "from 0"),
        (0, put("t", "0.02"), "t", "expected a number from 0, not '0.02'"),
        (0, put("speed", None), "speed", "not null"),
        (0, put("yaw_rate", ...), "yaw_rate", "yaw_rate or steering"),
        (1, put("steering", 1.6), "steering", "above -1.5708 up to 1.5708"),
        (2, put("t", 0.03), "t", "time runs backwards: 0.03 s after 0.04 s"),
        (2, put("sensor", "rear_camera"), "sensor", "a sensor of the header (front_camera, lidar), not 'rear_camera'"),
        (2, put("items", ...), "items", "a list of objects"),
        (2, put("items.0.range", ...), "items[0].range", "a number above 0"),
        (2, put("items.0.range", 0), "items[0].range", "above 0"),
        (2, put("items.0.bearing", 4), "items[0].bearing", "from -3.14159 to 3.14159"),
        (2, put("items.0.class", ...), "items[0].class", "printable text"),
        (2, put("items.0.sign", "SPEED"), "items[0].sign", "a SENSORIS TrafficSign type name, not 'SPEED'"),
        (2, put("items.0.value", 80), "items[0].value", "text"),
        (2, put("items.0.confidence", 0), "items[0].confidence", "above 0 up to 1, not 0"),
        (2, put("items.0.confidence", 1.01), "items[0].confidence", "above 0 up to 1, not 1.01"),
        (3, put("items.0.width", -1), "items[0].width", "from 0"),
        (4, put("items.0", {"range": 3, "bearing": 0, "class": "pole"}), "items[0].x", "a number"),
        (6, put("lat", -90.5), "lat", "from -90 to 90"),
        (6, put("std_m", -2.5), "std_m", "above 0"),
        (6, put("std_m", 10**400), "std_m", "a finite number above 0, not an integer beyond 64 bits"),
    ],
)
def test_a_fault_in_a_record_is_named(
    header: Json, records: list[Json], fault: tuple[int, Callable[[Json], None], str, str]
) -> None:
    record, change, field, expected = fault
    change(records[record])

    error = refusal([json.dumps(header), *(json.dumps(each) for each in records)])

    assert (error.line, error.field) == (record + 2, field)
    assert expected in error.message


def test_steering_needs_a_wheelbase(header: Json, records: list[Json]) -> None:
    del header["wheelbase_m"]

    error = refusal([json.dumps(header), json.dumps(records[1])])

    assert (error.line, error.field) == (2, "steering")
    assert "wheelbase_m in the header" in error.message


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ('{"t": 1, "type": "gnss"', "not valid JSON"),
        ("[1, 2]", "expected an object, not a list"),
        ('{"t": NaN, "type": "odometry"}', "NaN is not JSON"),
        ('{"t": 1, "type": "wipers", "on": -Infinity}', "-Infinity is not JSON"),
        ('{"t": 1e999, "type": "odometry", "speed": 1, "yaw_rate": 0}', "a finite number from 0, not inf"),
        ("[" * 100_000, "not valid JSON"),
        ('{"t": ' + "1" * 5000 + "}", "not valid JSON"),
        (b'{"t": "\xff"}', "not UTF-8: byte 0xff at column 8"),
    ],
)
def test_a_line_that_is_no_record_is_named(header: Json, line: str | bytes, expected: str) -> None:
    error = refusal([json.dumps(header), "", line])

    assert error.line == 3
    assert expected in error.message


@pytest.mark.parametrize("lines", [[], ["", "\n"]])
def test_an_empty_log_is_refused(lines: list[str]) -> None:
    assert "empty, expected a header" in refusal(lines).message


def test_good_records_before_the_fault_are_read(header: Json, records: list[Json]) -> None:
    _, stream = read_drive_log([json.dumps(header), json.dumps(records[0]), "{"])

    assert next(stream).t == 0.02
    with pytest.raises(FormatError, match="line 3"):
        next(stream)


scalars = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=5)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_stands_in_a_log_nothing_but_format_errors_come_out(
    header: Json, records: list[Json], data: st.DataObject
) -> None:
    documents: list[Any] = copy.deepcopy([header, *records])
    for _ in range(data.draw(st.integers(1, 3))):
        holder, key = data.draw(st.sampled_from(holders(documents)))
        holder[key] = data.draw(scalars | st.lists(scalars, max_size=2) | st.dictionaries(st.text(max_size=5), scalars))
    lines = [json.dumps(document) for document in documents]
    read: list[Record] = []
    try:
        read.extend(read_drive_log(lines)[1])
    except FormatError as error:
        place = error.line
    else:
        place = len(lines)

    assert place is not None
    assert 1 <= place <= len(lines)
    assert [record.t for record in read] == sorted(record.t for record in read)


@given(lines=st.lists(st.binary(max_size=50), max_size=3))
def test_any_bytes_that_are_no_log_are_refused(lines: list[bytes]) -> None:
    refusal(lines)


def holders(value: Any) -> list[tuple[Any, Any]]:
    """Return every (container, key) of a document."""
    if not isinstance(value, dict | list):
        return []
    pairs = list(value.items() if isinstance(value, dict) else enumerate(value))
    return [(value, key) for key, _ in pairs] + [found for _, each in pairs for found in holders(each)]


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_local_frame_reaches_a_hundred_kilometres_from_its_anchor(header: Json, axis: str, sign: float) -> None:
    header["frame"] = {"local": {"lon": 2.0, "lat": 48.0, "heading_deg": 0.0}}
    header["initial_pose"] = {"x": 0.0, "y": 0.0, "heading_deg": 0.0}
    fix = {"t": 0, "type": "gnss", "x": 0.0, "y": 0.0, "std_m": 2.0}
    for far in (1e5, 1e5 + 0.5):
        lines = [json.dumps(header), json.dumps(fix | {axis: sign * far})]
        if far == 1e5:
            assert len(list(read_drive_log(lines)[1])) == 1
        else:
            error = refusal(lines)
            assert (error.line, error.field) == (2, axis)
            assert "from -100000 to 100000" in error.message
