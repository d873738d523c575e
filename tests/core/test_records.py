"""What a car may hand to the filter: the bounds of every field, each of them still lawful and a little more not."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from slamcu_core.drive import (
    Detection,
    DetectionFrame,
    GnssFix,
    ObjectFrame,
    Occluder,
    Odometry,
    Record,
    Sensor,
    SensorKind,
)
from slamcu_core.errors import FieldError, SlamcuError
from slamcu_core.records import check_record

SENSORS = {"camera": Sensor("camera"), "lidar": Sensor("lidar", kind=SensorKind.POSITION)}
WHOLE_TURN = 2.0 * math.pi
Make = Callable[[float], Record]


def check(record: Record) -> None:
    check_record(record, SENSORS, wheelbase_m=2.5)


def seen(**fields: float) -> Record:
    return DetectionFrame(1.0, "camera", (Detection("traffic_sign", **({"range": 20.0, "bearing": 0.0} | fields)),))


def placed(**fields: float) -> Record:
    return DetectionFrame(1.0, "lidar", (Detection("traffic_sign", **({"x": 20.0, "y": 0.0} | fields)),))


def hiding(**fields: float) -> Record:
    return ObjectFrame(1.0, "camera", (Occluder(**({"range": 20.0, "bearing": 0.0, "width": 2.0} | fields)),))


BOUNDS: list[tuple[str, Make, float, float]] = [
    ("speed", lambda value: Odometry(1.0, value, yaw_rate=0.0), -150.0, 150.0),
    ("yaw_rate", lambda value: Odometry(1.0, 20.0, yaw_rate=value), -10.0, 10.0),
    ("steering", lambda value: Odometry(1.0, 0.001, steering=value), -1.57, 1.57),
    ("lon", lambda value: GnssFix(1.0, value, 48.9, 2.0), -180.0, 180.0),
    ("lat", lambda value: GnssFix(1.0, 2.1, value, 2.0), -90.0, 90.0),
    ("std_m", lambda value: GnssFix(1.0, 2.1, 48.9, value), 1e-3, 1e5),
    ("items[0].range", lambda value: seen(range=value), 0.0, 1e4),
    ("items[0].bearing", lambda value: seen(bearing=value), -WHOLE_TURN, WHOLE_TURN),
    ("items[0].confidence", lambda value: seen(confidence=value), 0.0, 1.0),
    ("items[0].x", lambda value: placed(x=value), -1e4, 1e4),
    ("items[0].y", lambda value: placed(y=value), -1e4, 1e4),
    ("items[0].range", lambda value: hiding(range=value), math.ulp(0.0), 1e4),
    ("items[0].bearing", lambda value: hiding(bearing=value), -WHOLE_TURN, WHOLE_TURN),
    ("items[0].width", lambda value: hiding(width=value), 0.0, 1e4),
]


@pytest.mark.parametrize(("field", "make", "low", "high"), BOUNDS)
def test_a_field_may_be_as_small_and_as_large_as_its_bounds_and_no_more(
    field: str, make: Make, low: float, high: float
) -> None:
    check(make(low))
    check(make(high))
    for beyond in (math.nextafter(low, -math.inf), math.nextafter(high, math.inf), math.nan, math.inf, -math.inf):
        with pytest.raises(FieldError) as refused:
            check(make(beyond))
        assert refused.value.field == field


@pytest.mark.parametrize("t", [-1e-9, math.nan, math.inf])
def test_a_time_is_counted_from_the_start_of_the_drive(t: float) -> None:
    check(Odometry(0.0, 20.0, yaw_rate=0.0))
    with pytest.raises(FieldError, match="seconds since the start"):
        check(Odometry(t, 20.0, yaw_rate=0.0))


@pytest.mark.parametrize(
    ("field", "record"),
    [
        ("items[0].range", DetectionFrame(1.0, "camera", (Detection("traffic_sign", bearing=0.0),))),
        ("items[0].bearing", DetectionFrame(1.0, "camera", (Detection("traffic_sign", range=20.0),))),
        ("items[0].x", DetectionFrame(1.0, "lidar", (Detection("traffic_sign", y=0.0),))),
        ("items[0].y", DetectionFrame(1.0, "lidar", (Detection("traffic_sign", x=20.0),))),
        (
            "items[1].bearing",
            DetectionFrame(1.0, "camera", (Detection("traffic_sign", 20.0, 0.0), Detection("traffic_sign", 20.0))),
        ),
    ],
)
def test_a_detection_without_what_its_sensor_measures_is_named(field: str, record: Record) -> None:
    with pytest.raises(FieldError) as refused:
        check(record)
    assert refused.value.field == field


def test_steering_may_not_turn_a_car_faster_than_anything_does() -> None:
    check(Odometry(1.0, 20.0, steering=0.5))
    with pytest.raises(FieldError, match="at most 10 rad/s") as refused:
        check(Odometry(1.0, 150.0, steering=0.5))
    assert refused.value.field == "steering"
    with pytest.raises(SlamcuError, match="wheelbase_m"):
        check_record(Odometry(1.0, 20.0, steering=0.1), SENSORS, wheelbase_m=None)


@pytest.mark.parametrize("fields", [{}, {"yaw_rate": 0.0, "steering": 0.0}])
def test_odometry_turns_in_one_way(fields: dict[str, float]) -> None:
    with pytest.raises(SlamcuError, match="either yaw_rate or steering"):
        check(Odometry(1.0, 20.0, **fields))


@pytest.mark.parametrize("frame", [DetectionFrame(1.0, "rear"), ObjectFrame(1.0, "rear")])
def test_a_sensor_that_the_header_lacks_is_named(frame: Record) -> None:
    with pytest.raises(SlamcuError, match=r"'rear' is not in the header, which has \['camera', 'lidar'\]"):
        check(frame)
