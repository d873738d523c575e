"""What makes no sense never reaches the particles, and numbers that break down are told as such."""

import math
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
)
from slamcu_core.errors import ClockError, FieldError, FilterLostError, SlamcuError
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.filter.particles import _root
from slamcu_core.hd_map import HDMap, MapFeature

MAP = HDMap([MapFeature(1, 2.1007, 48.9, sign="YIELD"), MapFeature(2, 2.1010, 48.90005, sign="YIELD")])
HEADER = DriveHeader(
    "v", "s", datetime(2026, 5, 1, tzinfo=UTC), InitialPose(2.1, 48.9, 90.0), (Sensor("camera"),), wheelbase_m=2.9
)
ANY = st.floats() | st.sampled_from([math.nan, math.inf, 0.0, 1e-300, 1e7, 1e300, -1e300])
TIME = ANY | st.floats(1.0, 4.0)


def drive() -> SlamcuFilter:
    car = SlamcuFilter(MAP, HEADER, FilterParameters(particles=20, max_new=8), rng=np.random.default_rng(2))
    for t in (0.0, 0.5, 1.0):
        car.feed(Odometry(t, 20.0, 0.0))
        car.feed(DetectionFrame(t, "camera", (Detection("traffic_sign", 51.0 - 20.0 * t, 0.0, sign="YIELD"),)))
    return car


RECORDS = st.one_of(
    st.builds(Odometry, TIME, ANY | st.just(20.0), ANY | st.just(0.0)),
    st.builds(Odometry, TIME, ANY | st.just(20.0), st.none(), ANY),
    st.builds(GnssFix, TIME, ANY | st.just(2.1002), ANY | st.just(48.9), ANY | st.just(2.0)),
    st.builds(
        lambda t, *values: DetectionFrame(t, "camera", (Detection("traffic_sign", *values[:2], confidence=values[2]),)),
        TIME,
        ANY | st.just(20.0),
        ANY | st.just(0.0),
        ANY | st.just(0.9),
    ),
    st.builds(lambda t, *values: ObjectFrame(t, "camera", (Occluder(*values),)), TIME, ANY, ANY, ANY),
)


@settings(max_examples=150, deadline=None)
@given(RECORDS)
def test_any_record_is_refused_as_if_it_had_not_come_or_leaves_numbers(record: Record) -> None:
    car = drive()
    before = car.pose, car.features(), car.health
    refused: SlamcuError | None = None
    try:
        car.feed(record)
    except SlamcuError as error:
        refused = error
    assert not isinstance(refused, FilterLostError)
    if refused is not None:
        assert (car.pose, car.features(), car.health) == before
    after = max(car.pose.t, 4.0) + 0.1
    car.feed(DetectionFrame(after, "camera", (Detection("traffic_sign", 20.0, 0.1, sign="YIELD"),)))
    pose = car.pose
    assert all(map(math.isfinite, (pose.lon, pose.lat, pose.heading_deg, *pose.covariance_m2)))
    assert all(math.isfinite(one.masses.exists) and math.isfinite(one.lon) for one in car.features())


@pytest.mark.parametrize("t", [3602.0, 1e6, 1.8e9])
def test_a_clock_that_is_wrong_by_more_than_an_hour_is_refused(t: float) -> None:
    car = drive()
    with pytest.raises(ClockError, match="leaps ahead") as told:
        car.feed(GnssFix(t, 2.1, 48.9, 2.5))
    assert (told.value.t, told.value.now) == (t, 1.0)
    car.feed(Odometry(1.1, 20.0, 0.0))
    assert car.pose.t == 1.1


WILD = [
    Odometry(1800.0, 20.0, 0.0),
    GnssFix(1800.0, 2.1, 48.9, 2.5),
    DetectionFrame(1800.0, "camera", (Detection("traffic_sign", 20.0, 0.0, sign="YIELD"),)),
    ObjectFrame(1800.0, "camera", (Occluder(10.0, 0.0, 2.5),)),
]


@pytest.mark.parametrize("wild", WILD, ids=lambda record: type(record).__name__)
def test_one_time_that_is_wrong_by_half_an_hour_changes_nothing(wild: Record) -> None:
    hit, plain = drive(), drive()
    assert hit.feed(wild) == []
    for step in range(1, 40):
        t = 1.0 + step / 10
        for record in (Odometry(t, 20.0, 0.0), DetectionFrame(t, "camera")):
            assert hit.feed(record) == plain.feed(record)
    assert (hit.pose, hit.features(), hit.health) == (plain.pose, plain.features(), plain.health)
    assert (hit.dropped, plain.dropped) == (1, 0)
    assert hit.time == 4.9


def test_the_first_time_of_a_drive_may_be_wrong_too() -> None:
    car = SlamcuFilter(MAP, HEADER, FilterParameters(particles=20), rng=np.random.default_rng(2))
    car.feed(DetectionFrame(900.0, "camera"))
    car.feed(DetectionFrame(0.1, "camera"))
    assert (car.time, car.dropped) == (0.1, 1)


@pytest.mark.parametrize("after", [100.0, 100.05, 200.0, 3_000.0])
def test_after_a_pause_the_next_record_confirms_the_time(after: float) -> None:
    car = drive()
    car.feed(Odometry(100.0, 20.0, 0.0))
    assert car.time == 1.0
    car.feed(DetectionFrame(after, "camera"))
    assert car.time == (after if after < 103.0 else 100.0)
    car.feed(Odometry(after + 0.1, 20.0, 0.0))
    assert car.time == after + 0.1
    assert car.dropped == 0


def test_what_waits_is_kept_when_the_next_record_is_refused() -> None:
    car = drive()
    car.feed(DetectionFrame(100.0, "camera"))
    for bad in (Odometry(0.5, 20.0, 0.0), Odometry(100.1, math.nan, 0.0), DetectionFrame(100.0, "camera")):
        with pytest.raises(SlamcuError):
            car.feed(bad)
    with pytest.raises(ClockError, match=r"t = 9000.0 s after 100.0 s"):
        car.feed(Odometry(9000.0, 20.0, 0.0))
    car.feed(Odometry(100.1, 20.0, 0.0))
    assert (car.time, car.dropped) == (100.1, 0)


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("not positive definite"), OverflowError("too large")])
def test_numbers_that_break_down_are_told_and_never_trusted(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    car = drive()

    def breaks_down(*_: object) -> None:
        raise error

    monkeypatch.setattr(car._frames, "take", breaks_down)
    assert car.health.trusted
    with pytest.raises(FilterLostError, match="a new session is needed"):
        car.feed(DetectionFrame(1.5, "camera"))
    assert not car.health.trusted
    with pytest.raises(FilterLostError):
        car.feed(Odometry(2.0, 20.0, 0.0))
    assert car.finish() == []


def test_a_pose_that_is_no_number_is_never_trusted() -> None:
    car = drive()
    car._particles.state[0, 3] = math.nan
    assert not car.health.trusted


def test_a_cloud_of_two_far_apart_has_a_root() -> None:
    apart = np.array([3e5, -2e5, 1.7])
    covariance = np.outer(apart, apart)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(covariance + 1e-12 * np.eye(3))
    root = _root(covariance)
    np.testing.assert_allclose(root @ root.T, covariance, rtol=1e-6)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -1e300])
@pytest.mark.parametrize(
    ("kind", "field"),
    [
        *((Sensor, name) for name in ("fov_deg", "min_range_m", "max_range_m", "rate_hz", "range_std_m")),
        *((Sensor, name) for name in ("range_std_rel", "bearing_std_rad", "position_std_m")),
        *((Sensor, name) for name in ("detection_probability", "false_alarms_per_frame")),
        *((InitialPose, name) for name in ("lon", "lat", "heading_deg", "position_std_m", "heading_std_deg")),
        *((Mount, name) for name in ("x", "y", "yaw_deg")),
        *((MapFeature, name) for name in ("lon", "lat", "position_std_m", "existence_confidence")),
    ],
)
def test_what_would_hang_or_break_the_filter_is_refused_by_name(kind: type, field: str, value: float) -> None:
    needed: dict[type, dict[str, object]] = {
        Sensor: {"id": "camera"},
        InitialPose: {"lon": 2.1, "lat": 48.9, "heading_deg": 0.0},
        MapFeature: {"object_id": 1, "lon": 2.1, "lat": 48.9},
    }
    if kind is MapFeature and field == "lon" and math.isfinite(value):
        value = math.nan
    with pytest.raises(FieldError, match=field):
        kind(**needed.get(kind, {}) | {field: value})


@pytest.mark.parametrize("reach", [1e-300, 0.0, 2_001.0, 1e12])
def test_a_reach_that_no_sensor_has_is_refused(reach: float) -> None:
    with pytest.raises(FieldError, match="max_range_m"):
        Sensor("camera", max_range_m=reach)
