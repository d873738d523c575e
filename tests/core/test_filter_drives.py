"""The filter on small drives whose truth is known: the paper's scenarios, passes, lorries, and refusals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
import pytest

from slamcu_core.drive import (
    Detection,
    DetectionFrame,
    DriveHeader,
    GnssFix,
    InitialPose,
    ObjectFrame,
    Occluder,
    Odometry,
    Record,
    Sensor,
)
from slamcu_core.errors import SlamcuError
from slamcu_core.evidence import support
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature, MapIdentity
from slamcu_core.reports import DetectionStatus, PassReport

FRAME = LocalFrame(2.1, 48.9)
CAMERA = Sensor(
    "camera", fov_deg=40, min_range_m=2, max_range_m=80, rate_hz=10, range_std_m=0.3, range_std_rel=0.02,
    bearing_std_rad=0.005, detection_probability=0.9,
)  # fmt: skip
SPEED = 20.0
HEADER = DriveHeader(
    "veh", "session", datetime(2026, 5, 1, tzinfo=UTC), InitialPose(2.1, 48.9, 90.0, 0.3, 0.3), (CAMERA,)
)

Show = Callable[[int, float, float, np.random.Generator], Detection | None]


def feature(object_id: int, x: float, y: float, **more: object) -> MapFeature:
    lon, lat = FRAME.to_geographic([x, y])
    return MapFeature(object_id, float(lon), float(lat), **more)  # type: ignore[arg-type]  # test data by keyword


def seen(distance: float, bearing: float, rng: np.random.Generator, **more: object) -> Detection:
    noisy = distance + rng.normal() * (0.3 + 0.02 * distance)
    return Detection("traffic_sign", range=noisy, bearing=bearing + 0.005 * rng.normal(), **more)  # type: ignore[arg-type]


def drive(
    signs: list[tuple[float, float]],
    seconds: float = 12.0,
    *,
    seed: int = 0,
    show: Show | None = None,
    gnss: bool = True,
    trucks: Callable[[float], tuple[Occluder, ...]] | None = None,
) -> Iterator[Record]:
    """Drive east at 20 m/s past signs in metres; `show(sign, distance, bearing, rng)` says what is detected."""
    rng = np.random.default_rng(seed)
    for step in range(1, round(seconds * 10)):
        yield Odometry((step - 1) / 10, SPEED, yaw_rate=0.0)
        t = step / 10
        if gnss and step % 10 == 0:
            lon, lat = FRAME.to_geographic([SPEED * t + rng.normal(), rng.normal()])
            yield GnssFix(t, float(lon), float(lat), 1.5)
        if trucks:
            yield ObjectFrame(t, "camera", trucks(t))
        items = []
        for index, (x, y) in enumerate(signs):
            distance, bearing = np.hypot(x - SPEED * t, y), np.arctan2(y, x - SPEED * t)
            if 2 < distance < 80 and abs(bearing) < np.deg2rad(20):
                detection = (
                    show(index, distance, bearing, rng)
                    if show
                    else (seen(distance, bearing, rng) if rng.random() < 0.9 else None)
                )
                if detection:
                    items.append(detection)
        yield DetectionFrame(t, "camera", tuple(items))


def run(
    features: list[MapFeature], records: Iterator[Record], seed: int = 0, **settings: float
) -> tuple[SlamcuFilter, list[PassReport]]:
    car = SlamcuFilter(
        HDMap(features, MapIdentity("road", "1")),
        HEADER,
        FilterParameters(**settings),  # type: ignore[arg-type]  # numbers by name
        rng=np.random.default_rng(seed),
    )
    reports = [report for record in records for report in car.feed(record)]
    return car, reports + car.finish()


def states(car: SlamcuFilter) -> dict[int | None, str]:
    return {f.feature.object_id if f.feature else None: f.state for f in car.features()}


def test_normal_deleted_and_new_are_told_apart_and_the_new_sign_is_placed() -> None:
    features = [feature(1, 100.0, 6.0), feature(2, 160.0, -6.0), feature(3, 900.0, 6.0)]
    car, reports = run(features, drive([(100.0, 6.0), (140.0, 7.0)]))
    assert states(car) == {1: "normal", 2: "deleted", 3: "normal", None: "new"}
    found = next(f for f in car.features() if f.feature is None)
    assert np.hypot(*(FRAME.to_local(found.lon, found.lat) - [140.0, 7.0])) < 1.5
    assert {r.status for r in reports} == {
        DetectionStatus.EXPECTED_AND_DETECTED,
        DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE,
        DetectionStatus.NOT_EXPECTED_AND_DETECTED,
    }
    never = next(f for f in car.features() if f.feature and f.feature.object_id == 3)
    assert (never.passes, never.masses.exists) == (0, pytest.approx(0.95))


@pytest.mark.parametrize("outlier", [None, 4])
def test_figure_8_deletion_from_the_map_and_one_outlier_changes_nothing(outlier: int | None) -> None:
    looks = 0

    def show(_: int, distance: float, bearing: float, rng: np.random.Generator) -> Detection | None:
        nonlocal looks
        looks += 1
        return seen(distance, bearing, rng) if looks == outlier else None

    car, _ = run([feature(1, 100.0, 8.0)], drive([(100.0, 8.0)], show=show), correlation_time_s=0.0)
    assert states(car)[1] == "deleted"
    assert looks > 10


@pytest.mark.parametrize("outlier", [None, 4])
def test_figure_8_creation_from_nothing_and_one_outlier_changes_nothing(outlier: int | None) -> None:
    looks = 0

    def show(_: int, distance: float, bearing: float, rng: np.random.Generator) -> Detection | None:
        nonlocal looks
        looks += 1
        return None if looks == outlier else seen(distance, bearing, rng)

    car, _ = run([], drive([(100.0, 8.0)], show=show), correlation_time_s=0.0)
    assert states(car) == {None: "new"}


def test_a_report_carries_the_pass_and_never_the_prior_of_the_map() -> None:
    reports = [
        run([feature(1, 100.0, 6.0, existence_confidence=prior)], drive([(100.0, 6.0)]))[1][0] for prior in (0.5, 0.95)
    ]
    assert reports[0].weight_for == pytest.approx(reports[1].weight_for, rel=0.05)
    assert reports[0].frames_detected > 20
    assert reports[0].reference is not None
    assert reports[0].reference.object_id == 1
    assert reports[0].started_at < reports[0].ended_at


def test_a_pass_ends_five_seconds_after_the_feature_left_the_view() -> None:
    car = SlamcuFilter(HDMap([feature(1, 60.0, 6.0)]), HEADER, rng=np.random.default_rng(0))
    closed = [(record.t, report) for record in drive([(60.0, 6.0)]) for report in car.feed(record)]
    assert len(closed) == 1
    t, report = closed[0]
    gap = t - (report.ended_at - HEADER.start_time).total_seconds()
    assert 5.0 <= gap <= 5.2
    assert car.finish() == []


def test_a_sign_behind_a_truck_is_blocked_not_missed() -> None:
    def truck(_: float) -> tuple[Occluder, ...]:
        return (Occluder(range=8.0, bearing=0.0, width=9.0),)

    car, reports = run([feature(1, 100.0, 6.0)], drive([(100.0, 6.0)], show=lambda *_: None, trucks=truck))
    assert states(car)[1] == "normal"
    assert [r.status for r in reports] == [DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED]
    assert reports[0].weight_against < 0.3
    assert reports[0].frames_blocked > 10


@pytest.mark.parametrize("lorry_speed", [22.0, 20.0, 18.0])
def test_a_sign_painted_on_a_lorry_is_never_new(lorry_speed: float) -> None:
    rng = np.random.default_rng(3)

    def records() -> Iterator[Record]:
        for step in range(1, 100):
            yield Odometry((step - 1) / 10, SPEED, yaw_rate=0.0)
            distance = 40.0 + (lorry_speed - SPEED) * step / 10
            yield DetectionFrame(step / 10, "camera", (seen(distance, 0.05, rng),))

    car, reports = run([], records())
    assert "new" not in states(car).values()
    assert reports == []


@pytest.mark.parametrize("seed", range(5))
def test_a_few_looks_at_a_sign_beside_the_road_prove_that_it_stands_still(seed: int) -> None:
    coarse = replace(CAMERA, range_std_m=3.0)
    rng = np.random.default_rng(seed)
    car = SlamcuFilter(HDMap([]), replace(HEADER, sensors=(coarse,)), rng=rng)
    car.feed(Odometry(0.0, SPEED, yaw_rate=0.0))
    for step in range(1, 9):  # the speed of a thing is known by their ranges to 6 m/s, by their bearings to 2 m/s
        x, y = 50.0 - 2.0 * step, 13.0
        measured = float(np.hypot(x, y) + rng.normal(0.0, 3.5)), float(np.arctan2(y, x) + rng.normal(0.0, 0.005))
        car.feed(
            DetectionFrame(step / 10, "camera", (Detection("traffic_sign", range=measured[0], bearing=measured[1]),))
        )
    (found,) = car.features()
    assert found.state == "new"


def test_what_was_seen_for_no_longer_than_errors_are_correlated_is_not_new() -> None:
    def show(_: int, distance: float, bearing: float, rng: np.random.Generator) -> Detection | None:
        return seen(distance, bearing, rng) if 24.0 < distance < 29.0 else None

    for seed in range(5):
        car, reports = run([], drive([(100.0, 7.0)], show=show, seed=seed), seed)
        assert (states(car), reports) == ({}, [])


def test_a_watch_feature_is_reported_seen_or_missed_and_never_localized_on() -> None:
    watched = [feature(7, 100.0, 6.0, tile_id=-5), feature(8, 150.0, -6.0, tile_id=-5)]
    _, reports = run(watched, drive([(100.0, 6.0)]))
    outcome = {r.reference.object_id: r for r in reports if r.reference}
    assert outcome[7].status is DetectionStatus.EXPECTED_AND_DETECTED
    assert outcome[8].status is DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE
    assert all(r.reference and r.reference.watched for r in reports)
    # a watch feature 4 m off its real place pulls the pose nowhere
    plain, _ = run([], drive([], gnss=False))
    biased, _ = run([feature(7, 104.0, 6.0, tile_id=-5)], drive([(100.0, 6.0)], gnss=False))
    shift = FRAME.to_local(biased.pose.lon, biased.pose.lat) - FRAME.to_local(plain.pose.lon, plain.pose.lat)
    assert abs(shift[0]) < 1.0


@pytest.mark.parametrize(
    ("sign", "value"), [("SPEED_LIMIT", "80"), ("NO_OVERTAKING", None)], ids=["another value", "another type"]
)
def test_another_sign_at_the_mapped_place_speaks_against_the_mapped_one_and_for_itself(
    sign: str, value: str | None
) -> None:
    def show(_: int, distance: float, bearing: float, rng: np.random.Generator) -> Detection:
        read = rng.random() < 0.85  # the rest has no content, and could be either
        return seen(distance, bearing, rng, sign=sign if read else None, value=value if read else None)

    mapped = feature(1, 100.0, 6.0, sign="SPEED_LIMIT", value="130")
    car, reports = run([mapped], drive([(100.0, 6.0)], show=show))
    assert states(car) == {1: "deleted", None: "new"}
    found = next(f for f in car.features() if f.feature is None)
    assert (found.sign, found.value) == (sign, value)
    against, confirms = sorted(reports, key=lambda report: report.reference is None)
    assert against.status is DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE
    assert against.weight_against > 1.0 > against.weight_for
    assert (against.sign, against.value) == ("SPEED_LIMIT", "130")
    assert confirms.status is DetectionStatus.NOT_EXPECTED_AND_DETECTED
    assert confirms.weight_for > 1.0 > confirms.weight_against
    assert (confirms.sign, confirms.value) == (sign, value)
    assert confirms.position is not None
    place = FRAME.to_local(confirms.position.lon, confirms.position.lat)
    assert np.hypot(*(place - (100.0, 6.0))) < 1.5


def test_a_sign_whose_value_cannot_be_read_confirms_the_mapped_one() -> None:
    def show(_: int, distance: float, bearing: float, rng: np.random.Generator) -> Detection:
        return seen(distance, bearing, rng, sign="SPEED_LIMIT" if rng.random() < 0.7 else None)

    mapped = feature(1, 100.0, 6.0, sign="SPEED_LIMIT", value="130")
    car, (report,) = run([mapped], drive([(100.0, 6.0)], show=show))
    assert states(car) == {1: "normal"}
    assert report.status is DetectionStatus.EXPECTED_AND_DETECTED
    assert report.weight_for > 3.0


def test_what_a_pass_sees_beside_the_mapped_place_and_misses_there_is_no_evidence_for_it() -> None:
    around = [feature(2, 60.0, -6.0), feature(3, 150.0, -6.0)]
    mapped = feature(1, 100.0, 6.0, sign="SPEED_LIMIT", value="130")

    def told(x: float, seed: int, nearest: float = 0.0) -> PassReport:
        def show(sign: int, distance: float, bearing: float, rng: np.random.Generator) -> Detection | None:
            if sign < 2:
                return seen(distance, bearing, rng)
            shown = distance > nearest and rng.random() < 0.9
            return seen(distance, bearing, rng, sign="SPEED_LIMIT", value="130") if shown else None

        signs = [(60.0, -6.0), (150.0, -6.0), (x, 6.0)]
        _, reports = run([mapped, *around], drive(signs, show=show, seed=seed), seed)
        return next(r for r in reports if r.reference is not None and r.reference.object_id == 1)

    # from afar a sign that stands 5 m on may be the mapped one, from near it is not
    moved = [report for report in (told(105.0, seed) for seed in range(5)) if report.frames_detected > 5]
    refuted = [report for report in moved if report.weight_for == 0.0]
    assert len(refuted) > len(moved) / 2
    assert {report.status for report in refuted} == {DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE}
    # one that is missed from near but was seen in its place may be hidden by something
    assert all(told(100.0, seed, nearest=45.0).weight_for > 3.0 for seed in range(3))


def test_a_sign_that_moved_by_a_few_metres_is_missed_in_its_place_and_found_in_another() -> None:
    others = [(20.0 * n, 6.0 * (-1) ** n) for n in (1, 2, 3, 4, 6, 7, 8, 9, 10)]
    around = [feature(n, *place) for n, place in enumerate(others, start=2)]
    mapped = feature(1, 100.0, 6.0, sign="SPEED_LIMIT", value="130")

    def told(x: float, seed: int, *more: MapFeature) -> tuple[list[PassReport], list[PassReport], list[PassReport]]:
        def show(sign: int, distance: float, bearing: float, rng: np.random.Generator) -> Detection:
            return seen(distance, bearing, rng, **({"sign": "SPEED_LIMIT", "value": "130"} if sign == 0 else {}))

        _, reports = run([mapped, *around, *more], drive([(x, 6.0), *others], show=show, seed=seed), seed)
        of_the_map = [r for r in reports if r.reference is not None and r.reference.object_id == 1]
        return of_the_map, [r for r in reports if r.reference is None], [r for r in reports if _watched(r)]

    def off(report: PassReport, x: float) -> float:
        assert report.position is not None
        return float(np.hypot(*(FRAME.to_local(report.position.lon, report.position.lat) - [x, 6.0])))

    for seed in range(6):
        (stays,), finds, _ = told(100.0, seed)
        assert stays.status is DetectionStatus.EXPECTED_AND_DETECTED
        assert finds == []
    moved = [told(103.5, seed) for seed in range(6)]
    found = [(missed, finds) for (missed,), finds, _ in moved if missed.weight_for == 0.0]
    assert len(found) >= 4
    for missed, (find,) in found:
        assert missed.status is DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE
        assert missed.weight_against > 2.0
        assert (find.status, find.sign, find.value) == (
            DetectionStatus.NOT_EXPECTED_AND_DETECTED, "SPEED_LIMIT", "130"
        )  # fmt: skip
        assert find.weight_for > 2.0
        assert off(find, 103.5) < off(find, 100.0)
    # who looks for a candidate there, and takes its sightings for the mapped sign, has nothing against it
    watch = feature(7, 103.5, 6.0, sign="SPEED_LIMIT", value="130", tile_id=-5, position_std_m=0.4)
    checked = [told(103.5, seed, watch) for seed in range(6)]
    assert all(report.weight_for >= report.weight_against for _, _, reports in checked for report in reports)
    assert all(missed.weight_for < missed.weight_against for (missed,), _, _ in checked)


def test_nobody_localizes_on_a_sign_that_is_believed_to_have_moved() -> None:
    moved = [feature(n, 30.0 * n, 6.0) for n in range(1, 7)]
    watches = [
        feature(n, 30.0 * n + 4.0, 6.0, tile_id=-1, position_std_m=0.3, moved_from=n) for n in range(1, 7)
    ]  # fmt: skip

    def astray(features: list[MapFeature], seed: int) -> float:
        signs = [(30.0 * n + 4.0, 6.0) for n in range(1, 7)]
        car, _ = run(features, drive(signs, seed=seed, gnss=False), seed)
        return float(np.hypot(*(FRAME.to_local(car.pose.lon, car.pose.lat) - [SPEED * car.pose.t, 0.0])))

    dragged, free = ([astray(features, seed) for seed in range(3)] for features in (moved, [*moved, *watches]))
    assert min(dragged) > 2.0
    assert max(free) < 1.5
    # nor does what is said of a sign that still stands keep anybody from seeing it
    stands, said = feature(1, 100.0, 6.0), feature(9, 103.0, 6.0, tile_id=-1, position_std_m=0.3, moved_from=1)
    others = [(20.0 * n, 6.0 * (-1) ** n) for n in (1, 2, 3, 4, 6, 7, 8, 9, 10)]
    around = [feature(n, *place) for n, place in enumerate(others, start=2)]
    for seed in range(3):
        _, reports = run([stands, *around, said], drive([(100.0, 6.0), *others], seed=seed), seed)
        (of_it,) = (r for r in reports if r.reference is not None and r.reference.object_id == 1)
        assert of_it.weight_for > max(3.0, of_it.weight_against)
        assert all(r.weight_for < r.weight_against for r in reports if _watched(r))


def _watched(report: PassReport) -> bool:
    return report.reference is not None and report.reference.watched


def test_equal_seeds_give_equal_drives_and_other_seeds_do_not() -> None:
    def outcome(seed: int) -> list[object]:
        car, reports = run([feature(1, 100.0, 6.0)], drive([(100.0, 6.0), (140.0, 7.0)]), seed=seed)
        return [car.pose, car.features(), reports]

    assert outcome(4) == outcome(4)
    assert outcome(4) != outcome(5)


def test_the_map_corrects_a_wrong_start() -> None:
    start = InitialPose(
        float(FRAME.to_geographic([-2.0, 1.5])[0]), float(FRAME.to_geographic([-2.0, 1.5])[1]), 90.0, 2.0, 1.0
    )
    header = DriveHeader("veh", "s", HEADER.start_time, start, (CAMERA,))
    signs = [(60.0 + 40.0 * i, 6.0 * (-1) ** i) for i in range(10)]
    car = SlamcuFilter(HDMap([feature(i + 1, *s) for i, s in enumerate(signs)]), header, rng=np.random.default_rng(1))
    for record in drive(signs, 20.0, gnss=False):
        car.feed(record)
    error = FRAME.to_local(car.pose.lon, car.pose.lat) - [SPEED * car.pose.t, 0.0]
    assert np.hypot(*error) < 1.0


def test_a_long_drive_moves_its_frame_along_without_a_jump() -> None:
    car = SlamcuFilter(HDMap([]), HEADER, FilterParameters(particles=20), rng=np.random.default_rng(1))
    places = []
    for t in range(1, 1000):
        car.feed(Odometry(t - 1.0, 40.0, yaw_rate=0.0))
        car.feed(DetectionFrame(float(t), "camera"))
        places.append((car.pose.lon, car.pose.lat))
    assert car.pose.lon > 2.5
    for before, after in pairwise(places):
        step = LocalFrame(*before).to_local(*after)
        assert 30.0 < np.hypot(*step) < 50.0


BEFORE = [Odometry(1.0, SPEED, yaw_rate=0.0), DetectionFrame(1.5, "camera")]


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (Odometry(0.5, SPEED, yaw_rate=0.0), "time runs backwards"),
        (Odometry(float("nan"), SPEED, yaw_rate=0.0), "t must be"),
        (DetectionFrame(1.5, "camera"), "two frames"),
        (DetectionFrame(2.0, "lidar"), "sensor 'lidar' is not in the header"),
        (DetectionFrame(2.0, "camera", (Detection("traffic_sign", x=1.0, y=1.0),)), r"items.0..range must be"),
        (Odometry(2.0, SPEED, steering=0.1), "wheelbase_m"),
        (Odometry(2.0, SPEED), "either yaw_rate or steering"),
    ],
    ids=["backwards", "nan", "twice", "unknown sensor", "wrong measurement", "no wheelbase", "no turn"],
)
def test_a_bad_record_is_refused_by_name_and_changes_nothing(record: Record, message: str) -> None:
    def car() -> SlamcuFilter:
        made = SlamcuFilter(HDMap([]), HEADER, rng=np.random.default_rng(0))
        for good in BEFORE:
            made.feed(good)
        return made

    tried, untouched = car(), car()
    with pytest.raises(SlamcuError, match=message):
        tried.feed(record)
    after = [DetectionFrame(3.0, "camera"), Odometry(4.0, SPEED, yaw_rate=0.1)]
    for good in after:
        assert tried.feed(good) == untouched.feed(good)
    assert tried.pose == untouched.pose


def test_settings_out_of_range_are_refused_by_name() -> None:
    with pytest.raises(SlamcuError, match="particles"):
        FilterParameters(particles=1)
    with pytest.raises(SlamcuError, match="pass_gap_s"):
        FilterParameters(pass_gap_s=-1.0)


def test_evidence_of_a_frame_is_tempered_by_the_time_since_the_last() -> None:
    car, reports = run([feature(1, 100.0, 6.0)], drive([(100.0, 6.0)]), correlation_time_s=0.3)
    expected = float(support(0.9)) * reports[0].frames_detected / 3.0
    assert reports[0].weight_for == pytest.approx(expected, rel=1e-6)
    assert car.health.trusted


def test_a_thing_at_range_0_of_a_sensor_without_error_there_is_no_error() -> None:
    exact = replace(CAMERA, min_range_m=0.0, range_std_m=0.0, range_std_rel=0.02)
    car = SlamcuFilter(HDMap([]), replace(HEADER, sensors=(exact,)), rng=np.random.default_rng(0))
    for step in range(1, 4):
        car.feed(DetectionFrame(step / 10, "camera", (Detection("traffic_sign", range=0.0, bearing=0.0),)))
    assert np.isfinite(car.pose.covariance_m2).all()
