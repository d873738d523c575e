"""While the odometer is silent nothing is assumed of the motion, and the filter says so until it knows where it is."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from slamcu_core.drive import Detection, DetectionFrame, DriveHeader, GnssFix, InitialPose, Odometry, Record, Sensor
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature
from slamcu_core.models import MotionNoise
from slamcu_core.reports import Doubt, PassReport

FRAME = LocalFrame(2.1, 48.9)
CAMERA = Sensor(
    "camera", fov_deg=40, max_range_m=80, rate_hz=10, range_std_m=0.3, range_std_rel=0.03, bearing_std_rad=0.006
)
START = datetime(2026, 5, 1, tzinfo=UTC)
SPEED, STD = 25.0, 2.5
HOLD = MotionNoise().hold_s


class Moment(NamedTuple):
    """What the filter says at one frame, beside the truth."""

    t: float
    error: float  # m
    std: float  # m
    doubt: Doubt | None


class Car:
    """A car that drives as it is told, and is fed what a test likes."""

    def __init__(self, places: NDArray[np.float64], seed: int = 2, camera: Sensor = CAMERA, **settings: object) -> None:
        features = []
        for key, place in enumerate(places, 1):
            lon, lat = FRAME.to_geographic(place)
            features.append(MapFeature(key, float(lon), float(lat), sign="YIELD"))
        header = DriveHeader("veh", "s", START, InitialPose(2.1, 48.9, 90.0, 1.5, 2.0), (camera,))
        parameters = FilterParameters(**settings)  # type: ignore[arg-type]
        self.filter = SlamcuFilter(HDMap(features), header, parameters, rng=np.random.default_rng(seed))
        self.rng = np.random.default_rng(seed + 50)
        self.places, self.camera = places, camera
        self.t, self.heading, self.place = 0.0, 0.0, np.zeros(2)
        self.moments: list[Moment] = []
        self.reports: list[PassReport] = []

    def drive(
        self,
        seconds: float,
        *,
        speed: float = SPEED,
        yaw_rate: float = 0.0,
        odometry: bool = True,
        fixes: bool = True,
        frames: bool = True,
    ) -> None:
        """Drive on; odometry at 10 Hz, fixes at 1 Hz and frames at 10 Hz, or not."""
        for _ in range(round(10 * seconds)):
            if odometry:
                self._feed(Odometry(self.t, speed, yaw_rate))
            self.t = round(self.t + 0.1, 6)
            middle = self.heading + 0.05 * yaw_rate
            self.heading += 0.1 * yaw_rate
            self.place = self.place + 0.1 * speed * np.array([np.cos(middle), np.sin(middle)])
            if odometry:
                self._feed(Odometry(self.t, speed, yaw_rate))
            if fixes and round(10 * self.t) % 10 == 0:
                self.fix()
            if frames:
                self.frame()

    def fix(self, *off: float) -> None:
        """Feed a fix, off by its noise or by so many metres."""
        lon, lat = FRAME.to_geographic(self.place + (off or self.rng.normal(0.0, 0.4 * STD, 2)))
        self._feed(GnssFix(self.t, float(lon), float(lat), STD))

    def frame(self) -> None:
        """Feed what the camera sees, and note what the filter says then."""
        self._feed(DetectionFrame(self.t, "camera", tuple(self._seen())))
        pose = self.filter.pose
        error = float(np.hypot(*(FRAME.to_local(pose.lon, pose.lat) - self.place)))
        std = float(np.sqrt(pose.covariance_m2[0] + pose.covariance_m2[2]))
        self.moments.append(Moment(self.t, error, std, self.filter.health.doubt))

    def _feed(self, record: Record) -> None:
        self.reports += self.filter.feed(record)

    def _seen(self) -> Iterator[Detection]:
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        for east, north in self.places - self.place:
            x, y = cos * east + sin * north, cos * north - sin * east
            distance, bearing = float(np.hypot(x, y)), float(np.arctan2(y, x))
            inside = distance < self.camera.max_range_m and abs(bearing) < np.radians(self.camera.fov_deg / 2)
            if inside and self.rng.random() < 0.9:
                std = self.camera.range_std_m + self.camera.range_std_rel * distance
                distance += std * self.rng.standard_normal()
                bearing += 0.006 * self.rng.standard_normal()
                yield Detection("traffic_sign", range=max(distance, 0.1), bearing=bearing, sign="YIELD")

    def since(self, t: float) -> list[Moment]:
        return [moment for moment in self.moments if moment.t > t + 1e-6]


NOTHING = np.zeros((0, 2))


def road(seed: int = 5) -> NDArray[np.float64]:
    """Return signs of an eastward road, at uneven distances so that no two stretches look alike."""
    rng = np.random.default_rng(seed)
    return np.stack(
        [60.0 + np.cumsum(rng.uniform(30, 80, 40)), rng.choice([-1, 1], 40) * rng.uniform(4, 9, 40)], axis=1
    )


def seconds_into_the_drive(report: PassReport) -> tuple[float, float]:
    return (report.started_at - START).total_seconds(), (report.ended_at - START).total_seconds()


@pytest.mark.parametrize("with_signs", [False, True])
@pytest.mark.parametrize("fixes", [True, False], ids=["odometry alone", "odometry and fixes"])
@pytest.mark.parametrize(("slows_by", "yaw_rate"), [(0.0, 0.0), (5.0, 0.0), (3.0, 0.2)], ids=["on", "stops", "turns"])
def test_in_a_gap_the_spread_tells_what_was_driven_and_fixes_bring_it_back(
    slows_by: float, yaw_rate: float, fixes: bool, with_signs: bool
) -> None:
    car = Car(road() if with_signs else NOTHING)
    car.drive(12.0)
    begin = car.t
    for second in range(8):
        speed = max(SPEED - slows_by * (second + 0.5), 0.0)
        car.drive(1.0, speed=speed, yaw_rate=yaw_rate, odometry=False, fixes=fixes)
    end = car.t
    car.drive(15.0)

    gap = [moment for moment in car.since(begin) if moment.t <= end]
    assert all(moment.doubt is None for moment in gap if moment.t < begin + HOLD)
    assert all(moment.doubt is Doubt.ODOMETRY for moment in gap if moment.t > begin + HOLD + 0.5)
    assert all(moment.error < 3.0 * moment.std for moment in gap if moment.doubt)
    assert max(moment.std for moment in gap) < (60.0 if fixes else 400.0)
    assert all(moment.doubt is None for moment in car.since(end + 6.0))
    assert max(moment.error for moment in car.since(end + 6.0)) < (5.0 if with_signs else 8.0)
    assert car.filter.fixes.restarts == 0
    doubt = [moment.t for moment in car.moments if moment.doubt]
    for first, last in map(seconds_into_the_drive, [*car.reports, *car.filter.finish()]):
        assert last < doubt[0] or first > doubt[-1]


@pytest.mark.parametrize("silence", [60.0, 600.0, 3_000.0])
@pytest.mark.parametrize("seed", [2, 3])
def test_a_long_silence_leaves_the_pose_where_it_was_vaguely(silence: float, seed: int) -> None:
    car = Car(road(), seed)
    car.drive(12.0)
    car.t += silence  # it stood
    car.frame()
    car.t += 0.1
    car.frame()  # a record after a pause waits for the next
    assert car.moments[-1].doubt is Doubt.ODOMETRY
    assert not car.filter.health.trusted
    assert car.moments[-1].error < HOLD * SPEED + 3.0
    assert min(SPEED * silence, 10_000.0) * 0.9 < car.moments[-1].std < 20_000.0
    begin = car.t
    car.drive(15.0)
    assert all(moment.doubt is None for moment in car.since(begin + 5.0))
    assert max(moment.error for moment in car.since(begin + 5.0)) < 5.0


def test_a_car_that_was_carried_off_in_the_meantime_is_found_by_its_fixes() -> None:
    car = Car(NOTHING)
    car.drive(12.0)
    car.t += 900.0
    car.place = np.array([-9_000.0, 12_000.0])  # by a ferry
    car.heading = 2.0
    begin = car.t
    car.drive(20.0)
    assert all(moment.doubt is None for moment in car.since(begin + 10.0))
    assert max(moment.error for moment in car.since(begin + 10.0)) < 8.0


def test_one_fix_far_beyond_what_can_have_been_driven_is_an_outlier_in_a_gap_too() -> None:
    car = Car(NOTHING)
    car.drive(12.0)
    car.drive(3.3, odometry=False, fixes=False)
    car.fix(0.0, 900.0)
    car.drive(0.1, odometry=False, fixes=False)
    assert car.filter.fixes.refused == 1
    assert car.moments[-1].error < 100.0
    assert car.moments[-1].doubt is Doubt.ODOMETRY
    begin = car.t
    car.drive(10.0)
    assert max(moment.error for moment in car.since(begin + 5.0)) < 8.0


def test_no_evidence_is_given_of_what_is_missed_from_a_pose_that_nobody_knows() -> None:
    """The car turned back during the silence: of the signs that it would have passed it says nothing."""
    car = Car(road())
    car.drive(12.0)
    before = {f.feature.object_id: (f.state, f.passes) for f in car.filter.features() if f.feature}
    car.drive(5.0, odometry=False, fixes=False, frames=False)
    car.place, car.heading = np.array([-400.0, 300.0]), np.pi
    car.drive(15.0, fixes=False)  # sees nothing, and hears of no fix
    assert car.moments[-1].doubt is Doubt.ODOMETRY
    after = {f.feature.object_id: (f.state, f.passes) for f in car.filter.features() if f.feature}
    assert {key for key, (state, _) in after.items() if state != before[key][0]} == set()
    assert max(seconds_into_the_drive(report)[1] for report in car.reports) < 12.0 + HOLD + 0.1
    assert car.filter.finish() == []


def test_what_was_believed_before_a_gap_is_believed_after_it() -> None:
    """Whatever a gap does to the pose, the finds of before stay where they are, and what was missed stays missed."""
    places = road()
    car = Car(places)
    car.places = np.delete(places, 4, axis=0)  # one of the map's is gone ...
    car.places = np.concatenate([car.places, [[200.0, 14.0]]])  # ... and one is new
    car.drive(20.0)
    new = next(f for f in car.filter.features() if f.feature is None and f.state == "new")
    gone = next(f for f in car.filter.features() if f.feature and f.feature.object_id == 5)
    assert gone.state == "deleted"
    car.t += 120.0
    car.drive(15.0)
    after = [f for f in car.filter.features() if f.feature is None and f.state == "new"]
    assert min(float(np.hypot(*FRAME.to_local(f.lon, f.lat) - FRAME.to_local(new.lon, new.lat))) for f in after) < 0.5
    assert next(f for f in car.filter.features() if f.feature and f.feature.object_id == 5).masses == gone.masses


@pytest.mark.parametrize("seed", [2, 3, 4])
@pytest.mark.parametrize("turned", [0.0, 2.5])
def test_the_map_alone_brings_it_back_where_there_is_much_to_see(seed: int, turned: float) -> None:
    rng = np.random.default_rng(seed)
    around = Sensor("camera", fov_deg=300, max_range_m=40, rate_hz=10, range_std_m=0.2, bearing_std_rad=0.006)
    car = Car(rng.uniform(-60, 60, (60, 2)), seed, around)
    car.drive(8.0, speed=2.0, yaw_rate=0.1, fixes=False)
    car.t += 20.0
    car.heading += turned
    begin = car.t
    car.drive(15.0, speed=2.0, fixes=False)
    assert car.since(begin)[0].doubt is Doubt.ODOMETRY
    assert all(moment.doubt is None for moment in car.since(begin + 8.0))
    assert max(moment.error for moment in car.since(begin + 8.0)) < 1.0


def test_odometry_once_a_second_is_no_gap() -> None:
    car = Car(NOTHING)
    for _ in range(20):
        car._feed(Odometry(car.t, SPEED, 0.0))
        car.drive(1.0, odometry=False, fixes=False)
    assert all(moment.doubt is None for moment in car.moments)
    assert car.moments[-1].error < 20.0


def test_a_slower_odometer_can_be_allowed_for() -> None:
    car = Car(NOTHING, motion=MotionNoise(hold_s=4.0))
    for _ in range(5):
        car._feed(Odometry(car.t, SPEED, 0.0))
        car.drive(3.0, odometry=False, fixes=False)
    assert all(moment.doubt is None for moment in car.moments)


def test_a_car_without_an_odometer_is_never_sure() -> None:
    car = Car(road())
    car.drive(20.0, odometry=False)
    assert all(moment.doubt is Doubt.ODOMETRY for moment in car.since(HOLD + 1.0))
    assert max(moment.error for moment in car.moments) < 3.0 * SPEED
    assert [report for report in car.reports if seconds_into_the_drive(report)[1] > HOLD + 1.0] == []


def test_a_drive_begins_with_its_first_record() -> None:
    """What booted ten seconds after its start time has not been silent for ten seconds."""
    car = Car(road())
    car.t = 10.0
    car.drive(12.0)
    assert all(moment.doubt is None for moment in car.moments)
    assert max(moment.error for moment in car.moments) < 5.0


def test_passes_that_a_gap_ends_are_told_as_what_was_known_before_it() -> None:
    car = Car(road())
    car.drive(12.0)
    open_passes = len(car.filter._management.open)
    assert open_passes
    told = len(car.reports)
    car.drive(HOLD + 0.2, odometry=False, fixes=False)
    assert len(car.reports) > told
    assert car.filter.health.trusted
    positions = [report.position for report in car.reports[told:] if report.position]
    assert all(position.covariance_m2[0] < 9.0 for position in positions)


@pytest.mark.parametrize("silence", [30.0, 600.0])
def test_passes_that_a_silence_of_all_records_ends_go_with_the_health_of_before_it(silence: float) -> None:
    car = Car(road())
    car.drive(12.0)
    begin, told = car.t, len(car.reports)
    assert car.filter.health_of_passes == car.filter.health
    car.t = round(car.t + silence, 6)  # the car stands, and nothing is heard of it
    car._feed(Odometry(car.t, 0.0, 0.0))
    car._feed(Odometry(car.t + 0.1, 0.0, 0.0))
    ended = car.reports[told:]
    assert ended
    assert max(seconds_into_the_drive(report)[1] for report in ended) <= begin
    assert car.filter.health.doubt is Doubt.ODOMETRY
    assert car.filter.health_of_passes.trusted
    car._feed(Odometry(car.t + 0.2, 0.0, 0.0))
    assert not car.filter.health_of_passes.trusted
