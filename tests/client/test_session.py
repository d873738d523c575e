from __future__ import annotations

import doctest
import sqlite3
import subprocess
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import slamcu_client.session
from slamcu_client import Outbox, ReportPolicy, SessionClockError, SessionClosedError, SessionError, VehicleSession
from slamcu_core.drive import Detection, DetectionFrame, GnssFix, ObjectFrame, Occluder, Odometry, Sensor, SensorKind
from slamcu_core.filter import FilterParameters
from slamcu_core.reports import DetectionStatus, PassReport, ReportMessage
from slamcu_core.sensoris import decode_message

FEW = FilterParameters(particles=20)
OFTEN = ReportPolicy(interval_s=2.0, max_passes=3)


def session_on(drive, outbox: Outbox | None, policy: ReportPolicy = OFTEN, seed: int = 1) -> VehicleSession:
    return VehicleSession(drive.hd_map, drive.header, outbox, FEW, seed=seed, report_policy=policy)


def messages_in(outbox: Outbox) -> list[ReportMessage]:
    return [decode_message(message.body) for message in outbox.pending(10_000)]


def passes_in(outbox: Outbox) -> list[PassReport]:
    return [report for message in messages_in(outbox) for report in message.passes]


@pytest.fixture(scope="module")
def undisturbed(drive, tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """The messages of the drive when nothing goes wrong."""
    with Outbox(tmp_path_factory.mktemp("undisturbed") / "o") as outbox:
        with session_on(drive, outbox) as session:
            for record in drive.records:
                session.feed(record)
        return [message.body for message in outbox.pending(10_000)]


def test_the_example_in_the_documentation_runs() -> None:
    result = doctest.testmod(slamcu_client.session)
    assert result.attempted > 5
    assert result.failed == 0


def test_a_drive_tells_normal_from_deleted(drive) -> None:
    with session_on(drive, None) as session:
        for record in drive.records:
            session.feed(record)
    states = {estimate.feature.object_id: estimate.state for estimate in session.features() if estimate.feature}
    assert states == {i: "deleted" if i in drive.gone else "normal" for i in states}
    assert len(states) == len(drive.hd_map)
    assert session.health.trusted
    assert session.pose.t == drive.records[-1].t
    assert (session.passes, session.passes_reported) == (len(states), 0)


def test_the_messages_of_a_drive(drive, tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        with session_on(drive, outbox) as session:
            for record in drive.records:
                session.feed(record)
        messages = messages_in(outbox)
    assert [message.message_id for message in messages] == list(range(1, len(messages) + 1))
    assert [message.last_of_session for message in messages] == [False] * (len(messages) - 1) + [True]
    assert len(messages) > 3
    assert all(len(message.passes) <= 3 for message in messages)
    for message in messages:
        assert (message.session_id, message.vehicle_id, message.fleet_id) == ("drive-1", "veh-007", "test")
        assert message.map_identity == drive.hd_map.identity
        assert message.sensor_model == "front_camera"
        assert message.software_version.startswith("slamcu-client/")
        assert message.health.trusted
    by_id = {report.reference.object_id: report for message in messages for report in message.passes}
    assert set(by_id) == {feature.object_id for feature in drive.hd_map}
    assert session.passes_reported == len(by_id)
    for object_id, report in by_id.items():
        seen = object_id not in drive.gone
        assert report.status is (
            DetectionStatus.EXPECTED_AND_DETECTED
            if seen
            else DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE
        )
        assert seen or report.weight_for == 0.0, "the map's prior is no evidence of the pass"


def test_the_same_drive_makes_the_same_bytes(drive, undisturbed: list[bytes], tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        with session_on(drive, outbox) as session:
            for record in drive.records:
                if isinstance(record, Odometry):
                    session.odometry(record.t, record.speed, yaw_rate=record.yaw_rate)
                elif isinstance(record, DetectionFrame):
                    session.detections(record.t, record.sensor, list(record.items))
        assert [message.body for message in outbox.pending(10_000)] == undisturbed


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cuts=st.lists(st.integers(0, 391), min_size=1, max_size=3))
def test_a_drive_that_is_cut_short_and_driven_again_reports_each_pass_once(
    drive, undisturbed: list[bytes], tmp_path_factory, cuts: list[int]
) -> None:
    with Outbox(tmp_path_factory.mktemp("cut") / "o") as outbox:
        for cut in cuts:
            session = session_on(drive, outbox)
            for record in drive.records[:cut]:
                session.feed(record)
            session.abandon()
        with session_on(drive, outbox) as session:
            for record in drive.records:
                session.feed(record)
        assert [message.body for message in outbox.pending(10_000)] == undisturbed
        assert session.passes_reported == session.passes


def test_no_pass_falls_between_two_messages_wherever_the_drive_is_cut(dense_drive, tmp_path: Path) -> None:
    """Passes end in almost every frame and are stored at once: any slip of one instant loses or doubles one."""
    at_once = ReportPolicy(interval_s=0.0)

    def run(name: str, cut: int | None) -> list[bytes]:
        with Outbox(tmp_path / name) as outbox:
            for last in (None,) if cut is None else (cut, None):
                session = session_on(dense_drive, outbox, at_once)
                for record in dense_drive.records[:last]:
                    session.feed(record)
                if last is None:
                    session.close()
                else:
                    session.abandon()
            return [message.body for message in outbox.pending(10_000)]

    whole = run("whole", None)
    assert len(whole) > 15
    for cut in (142, 143, 150, 151, 166, 167):  # between and after the two records of one instant
        assert run(f"cut-{cut}", cut) == whole


_CHILD = """
import sys
sys.path.insert(0, sys.argv[2])
from conftest import make_drive
from slamcu_client import Outbox, ReportPolicy, VehicleSession
from slamcu_core.filter import FilterParameters
drive = make_drive()
outbox = Outbox(sys.argv[1])
policy = ReportPolicy(interval_s=2.0, max_passes=3)
few = FilterParameters(particles=20)
session = VehicleSession(drive.hd_map, drive.header, outbox, few, seed=1, report_policy=policy)
for record in drive.records:
    session.feed(record)
    print(outbox.session("drive-1").last_message_id, flush=True)
print("at the end", flush=True)
session.close()
"""


def test_a_session_killed_with_9_goes_on_under_its_id(drive, undisturbed: list[bytes], tmp_path: Path) -> None:
    for stop_at in ("1", "3"):
        with subprocess.Popen(
            [sys.executable, "-c", _CHILD, str(tmp_path / "o"), str(Path(__file__).parent)],
            stdout=subprocess.PIPE,
            text=True,
        ) as child:
            assert child.stdout is not None
            for line in child.stdout:
                assert line.strip() != "at the end"
                if line.strip() == stop_at:
                    child.kill()
                    break
    with Outbox(tmp_path / "o") as outbox:
        assert 3 <= outbox.session("drive-1").last_message_id < len(undisturbed)
        with session_on(drive, outbox) as session:
            for record in drive.records:
                session.feed(record)
        assert [message.body for message in outbox.pending(10_000)] == undisturbed


def test_a_live_car_that_restarts_goes_on_with_the_next_ids(drive, tmp_path: Path) -> None:
    half = len(drive.records) // 2
    with Outbox(tmp_path / "o") as outbox:
        first = session_on(drive, outbox)
        for record in drive.records[:half]:
            first.feed(record)
        first.abandon()
        before = outbox.session("drive-1").last_message_id
        assert before > 0
        with session_on(drive, outbox) as second:  # it sees only what comes after the restart
            for record in drive.records[half:]:
                second.feed(record)
        messages = messages_in(outbox)
    assert [message.message_id for message in messages] == list(range(1, len(messages) + 1))
    assert len(messages) > before


def test_a_closed_session_takes_nothing_more(drive, tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        session = session_on(drive, outbox)
        session.odometry(0.0, 10.0, yaw_rate=0.0)
        session.close()
        session.close()
        with pytest.raises(SessionClosedError):
            session.odometry(1.0, 10.0, yaw_rate=0.0)
        with pytest.raises(SessionClosedError, match="new session id"):
            session_on(drive, outbox)
        (only,) = messages_in(outbox)
        assert (only.message_id, only.last_of_session, only.passes) == (1, True, ())


def test_an_error_in_the_drive_leaves_the_session_open_for_another_try(drive, tmp_path: Path) -> None:
    def breaks_down() -> None:
        with session_on(drive, outbox) as session:
            for record in drive.records[:300]:
                session.feed(record)
            raise KeyboardInterrupt

    with Outbox(tmp_path / "o") as outbox:
        with pytest.raises(KeyboardInterrupt):
            breaks_down()
        state = outbox.session("drive-1")
        assert state.last_message_id > 0
        assert not state.closed


def test_one_wild_time_changes_no_message(drive, tmp_path: Path, undisturbed: list[bytes]) -> None:
    middle = len(drive.records) // 2
    wild = replace(drive.records[middle], t=drive.records[middle].t + 1_800.0)
    with Outbox(tmp_path / "o") as outbox:
        with session_on(drive, outbox) as session:
            for record in [*drive.records[:middle], wild, *drive.records[middle:]]:
                session.feed(record)
            assert session.records_dropped == 1
        assert [message.body for message in outbox.pending(10_000)] == undisturbed


def test_what_was_seen_before_a_long_silence_is_reported_without_the_doubt_that_follows_it(
    drive, tmp_path: Path, undisturbed: list[bytes]
) -> None:
    middle = len(drive.records) // 2
    later = [replace(record, t=record.t + 300.0) for record in drive.records[middle:]]
    with Outbox(tmp_path / "o") as outbox:
        with session_on(drive, outbox) as session:
            for record in [*drive.records[:middle], *later[:2]]:
                session.feed(record)
            assert not session.health.trusted
        told = messages_in(outbox)
    before = drive.header.start_time + timedelta(seconds=drive.records[middle].t)
    seen = [report for message in told for report in message.passes]
    assert seen
    assert all(report.ended_at <= before for report in seen)
    assert {message.health.trusted for message in told if message.passes} == {True}


def test_a_clock_that_is_set_back_is_told_from_other_errors_and_a_session_can_follow(drive, tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        session = session_on(drive, outbox)
        for record in drive.records[:60]:
            session.feed(record)
        last = drive.records[59].t
        for ahead in range(3):
            with pytest.raises(SessionClockError, match="time runs backwards"):
                session.odometry(last - 1.0 + 0.1 * ahead, 10.0, 0.0)
        with pytest.raises(SessionClockError, match="leaps ahead"):
            session.odometry(last + 4_000.0, 10.0, 0.0)
        session.feed(drive.records[60])
        session.close()
        pose, sigma = session.pose, session.pose.covariance_m2[0] ** 0.5
        start = replace(drive.header.initial_pose, lon=pose.lon, lat=pose.lat, position_std_m=sigma)
        header = replace(drive.header, session_id="drive-2", initial_pose=start)
        with VehicleSession(drive.hd_map, header, outbox) as following:
            for record in drive.records[61:]:
                following.feed(replace(record, t=record.t - drive.records[61].t))
        told = {one.feature.object_id: one.state for one in following.features() if one.feature and one.passes}
        assert len(told) >= len(drive.hd_map) - 3
        assert told == {i: "deleted" if i in drive.gone else "normal" for i in told}
        assert {message.session_id for message in messages_in(outbox)} == {"drive-1", "drive-2"}


CAMERA = replace(Sensor("cam"), kind=SensorKind.RANGE_BEARING)
LIDAR = replace(Sensor("lidar"), kind=SensorKind.POSITION)


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (Odometry(0.5, 1.0, 0.0), "time runs backwards"),
        (Odometry(float("nan"), 1.0, 0.0), "t must be"),
        (Odometry(-1.0, 1.0, 0.0), "t must be"),
        (Odometry(2.0, float("inf"), 0.0), "speed must be"),
        (Odometry(2.0, 1.0), "either yaw_rate or steering"),
        (Odometry(2.0, 1.0, 0.1, 0.1), "either yaw_rate or steering"),
        (Odometry(2.0, 1.0, steering=0.1), "wheelbase_m"),
        (Odometry(2.0, 1.0, float("nan")), "yaw_rate must be"),
        (GnssFix(2.0, 181.0, 0.0, 1.0), "lon must be"),
        (GnssFix(2.0, 0.0, float("nan"), 1.0), "lat must be"),
        (GnssFix(2.0, 0.0, 0.0, 0.0), "std_m must be"),
        (DetectionFrame(2.0, "radar"), "sensor 'radar' is not in the header, which has .'cam', 'lidar'."),
        (ObjectFrame(2.0, "radar"), "sensor 'radar' is not"),
        (DetectionFrame(2.0, "cam", (Detection("traffic_sign", 5.0, 0.0), Detection("traffic_sign"))), r"items\[1\]"),
        (DetectionFrame(2.0, "cam", (Detection("traffic_sign", -1.0, 0.0),)), r"items\[0\].range must be"),
        (DetectionFrame(2.0, "cam", (Detection("traffic_sign", 1.0, float("nan")),)), "bearing must be"),
        (DetectionFrame(2.0, "cam", (Detection("traffic_sign", 1.0, 0.0, confidence=1.5),)), "confidence must be"),
        (DetectionFrame(2.0, "lidar", (Detection("traffic_sign", x=1.0),)), "y must be"),
        (ObjectFrame(2.0, "cam", (Occluder(1.0, 0.0, float("inf")),)), "width must be"),
        (ObjectFrame(2.0, "cam", (Occluder(0.0, 0.0, 1.0),)), "range must be"),
    ],
)
def test_a_record_that_makes_no_sense_is_named_and_counts_for_nothing(drive, record, message: str) -> None:
    header = replace(drive.header, sensors=(CAMERA, LIDAR))
    with VehicleSession(drive.hd_map, header, None, FEW) as session:
        session.odometry(1.0, 20.0, yaw_rate=0.0)
        with pytest.raises(SessionError, match=message):
            session.feed(record)
        session.occluders(1.0, "cam", [Occluder(10.0, 0.0, 2.0)])
        session.gnss(1.5, 2.1, 48.9, 2.0)
        assert session.pose.t == 1.5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"session_id": ""}, "session_id"),
        ({"session_id": "a\nb"}, "printable"),
        ({"start_time": "naive"}, "time zone"),
    ],
)
def test_a_header_that_no_report_could_carry_is_refused_at_the_start(drive, tmp_path: Path, changes, message) -> None:
    if "start_time" in changes:
        changes = {"start_time": drive.header.start_time.replace(tzinfo=None)}
    with Outbox(tmp_path / "o") as outbox, pytest.raises(SessionError, match=message):
        VehicleSession(drive.hd_map, replace(drive.header, **changes), outbox, FEW)


def test_a_disk_that_hangs_does_not_hold_up_the_filter(drive, undisturbed: list[bytes], tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        hang = sqlite3.connect(tmp_path / "o", isolation_level=None, check_same_thread=False)
        hang.execute("BEGIN IMMEDIATE")  # from here on nobody else can write
        session = session_on(drive, outbox)
        for record in drive.records:
            session.feed(record)
        assert session.features(), "the whole drive went through while not one message could be stored"
        assert session.passes_reported == 0
        hang.execute("ROLLBACK")
        hang.close()
        session.close()
        assert [message.body for message in outbox.pending(10_000)] == undisturbed
