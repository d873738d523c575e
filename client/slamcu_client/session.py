"""The session: what a car's software feeds while it drives, or a recorded log in its place."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime, timedelta
from types import TracebackType
from typing import Self

import numpy as np

from slamcu_client.errors import SessionClockError, SessionClosedError, SessionError
from slamcu_client.kinds import with_kinds
from slamcu_client.outbox import Outbox
from slamcu_client.reporter import Reporter, ReportPolicy
from slamcu_client.version import SOFTWARE_VERSION
from slamcu_core.drive import (
    Detection,
    DetectionFrame,
    DriveHeader,
    GnssFix,
    ObjectFrame,
    Occluder,
    Odometry,
    Record,
)
from slamcu_core.errors import ClockError, SlamcuError, WireError
from slamcu_core.filter import FeatureEstimate, FilterParameters, PoseEstimate, SlamcuFilter
from slamcu_core.hd_map import HDMap
from slamcu_core.reports import Health, ReportMessage
from slamcu_core.sensoris import check_message

_CLOSE_TIMEOUT_S = 30.0


class VehicleSession:
    """Compare what a car sees with its HD map, and report the evidence of each pass.

    Feed it what the car measures, in order of time; every call steps the filter and returns at once. When a feature
    has left the view, the evidence of that pass goes to the outbox from a thread of the session's own, so that neither
    disk nor network can hold up the filter. Closing the session ends the passes that are still open.

    >>> from datetime import UTC, datetime
    >>> from slamcu_client import VehicleSession
    >>> from slamcu_core.drive import Detection, DriveHeader, InitialPose, Sensor
    >>> from slamcu_core.hd_map import HDMap, MapFeature
    >>> sign = MapFeature(object_id=17, lon=2.1007, lat=48.9, sign="SPEED_LIMIT", value="80")
    >>> header = DriveHeader(
    ...     vehicle_id="veh-007", session_id="2026-05-01T08:00Z-007",
    ...     start_time=datetime(2026, 5, 1, 8, tzinfo=UTC),
    ...     initial_pose=InitialPose(lon=2.1, lat=48.9, heading_deg=90.0),
    ...     sensors=(Sensor("front_camera", rate_hz=10.0),),
    ... )
    >>> with VehicleSession(HDMap([sign]), header, seed=1) as session:
    ...     for step in range(30):  # the sign is 51 m ahead; 20 m/s, ten frames a second
    ...         t, distance = 0.1 * step, 51.0 - 2.0 * step
    ...         session.odometry(t, speed=20.0, yaw_rate=0.0)
    ...         seen = [Detection("traffic_sign", range=distance, bearing=0.0, sign="SPEED_LIMIT", value="80")]
    ...         session.detections(t, "front_camera", seen if distance > 2.0 else [])
    >>> [(estimate.feature.object_id, estimate.state) for estimate in session.features()]
    [(17, 'normal')]

    With an `Outbox` as the third argument the passes are kept until an `Uploader` has brought them to the server.

    Parameters
    ----------
    hd_map : the map to compare with, watch features included.
    header : who drives, when, where from and with which sensors. The `vehicle_id` travels with the reports: make it a
        pseudonym. The `session_id` must be new for each drive.
    outbox : where reports go; None: only the local result.
    parameters : the filter's settings.
    seed : of the filter's random numbers: the same records and seed give the same result.
    sensor_model : what the server's trust in the reports is kept by; the sensors' ids unless given.
    software_version : likewise; the name and version of the SDK unless given.
    report_policy : how passes are grouped into messages.

    A session that a crash cut short can be taken up again under its id: its message ids go on where they stopped, and
    what was reported is not reported again, even if a recorded log is driven from its start.

    Raises SessionClosedError if the outbox knows the session as closed, SessionError if the header says what no report
    could carry, OutboxError if the outbox cannot be read.
    """

    def __init__(
        self,
        hd_map: HDMap,
        header: DriveHeader,
        outbox: Outbox | None = None,
        parameters: FilterParameters | None = None,
        *,
        seed: int = 0,
        sensor_model: str | None = None,
        software_version: str = SOFTWARE_VERSION,
        report_policy: ReportPolicy | None = None,
    ) -> None:
        self._header = header
        template = ReportMessage(
            session_id=header.session_id,
            message_id=1,
            vehicle_id=header.vehicle_id,
            fleet_id=header.fleet_id,
            map_identity=hd_map.identity,
            sensor_model=",".join(sensor.id for sensor in header.sensors) if sensor_model is None else sensor_model,
            software_version=software_version,
        )
        if outbox is not None:
            _check_start(template, header, outbox)
        self._filter = SlamcuFilter(
            hd_map,
            header,
            FilterParameters() if parameters is None else parameters,
            rng=np.random.default_rng(seed),
        )
        self._reporter = None if outbox is None else Reporter(outbox, template, report_policy or ReportPolicy())
        self._t: float | None = None
        self._passes = 0
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    # --- what the car measures --------------------------------------------------------------------------------------

    def odometry(self, t: float, speed: float, yaw_rate: float | None = None, steering: float | None = None) -> None:
        """Take the speed (m/s) with the yaw rate (rad/s, counter-clockwise) or the front wheel angle (rad)."""
        self.feed(Odometry(t, speed, yaw_rate, steering))

    def gnss(self, t: float, lon: float, lat: float, std_m: float) -> None:
        """Take a satellite position (degrees) with the standard deviation of each axis (m)."""
        self.feed(GnssFix(t, lon, lat, std_m))

    def detections(self, t: float, sensor: str, items: Iterable[Detection]) -> None:
        """Take all that one sensor saw at `t`; none: it looked and saw nothing, which is evidence too."""
        self.feed(DetectionFrame(t, sensor, tuple(items)))

    def occluders(self, t: float, sensor: str, items: Iterable[Occluder]) -> None:
        """Take the objects that can hide features from a sensor; to be given before the detections of the same `t`."""
        self.feed(ObjectFrame(t, sensor, tuple(items)))

    def feed(self, record: Record) -> None:
        """Take one record of any kind.

        After a pause of more than 3 s a record counts once the next has confirmed its time.

        Raises SessionClockError, and the record counts for nothing, if time runs backwards or leaps ahead by more than
        an hour, SessionError if the sensor is not in the header or a value makes no sense, and SessionClosedError after
        `close`.
        """
        if self._closed:
            raise SessionClosedError("the session is closed")
        try:
            passes = self._filter.feed(record)
        except ClockError as error:
            raise SessionClockError(str(error)) from error
        except SlamcuError as error:
            raise SessionError(str(error)) from error
        t, before = self._filter.time, self._t
        if self._reporter is not None and before is not None and t > before:
            self._reporter.tick(t, self._instant(before))
        self._t = t
        if passes:
            self._passes += len(passes)
            if self._reporter is not None:
                self._reporter.add(passes, self._filter.health_of_passes, t, self._instant(t))

    def close(self, timeout_s: float = _CLOSE_TIMEOUT_S) -> None:
        """End the passes that are open and wait until all reports are on disk; more calls do nothing.

        Raises OutboxError if the disk did not take them within `timeout_s`.
        """
        if self._closed:
            return
        self._closed = True
        passes = self._filter.finish()
        self._passes += len(passes)
        if self._reporter is not None:
            instant = self._instant(self._t or 0.0)
            self._reporter.finish(passes, self._filter.health_of_passes, instant, timeout_s)

    def abandon(self, timeout_s: float = _CLOSE_TIMEOUT_S) -> None:
        """Stop as a crash would: open passes are not reported, and the session may be taken up again.

        Leaving the `with` block by an exception does this.
        """
        if self._closed:
            return
        self._closed = True
        if self._reporter is not None:
            self._reporter.abandon(timeout_s)

    def _instant(self, t: float) -> datetime:
        return self._header.start_time + timedelta(seconds=t)

    # --- what is known ----------------------------------------------------------------------------------------------

    @property
    def pose(self) -> PoseEstimate:
        """Where the car is, with its uncertainty."""
        return self._filter.pose

    def features(self) -> list[FeatureEstimate]:
        """Return what this car believes about every feature of the map, also those never in view, and the new ones.

        A sign that is gone and another in its place are one that is `modified`; see `slamcu_client.kinds`.
        """
        return with_kinds(self._filter.features())

    @property
    def health(self) -> Health:
        """How far the filter is to be trusted now."""
        return self._filter.health

    @property
    def records_dropped(self) -> int:
        """How many records came after a pause with a time that the next one showed to be wrong."""
        return self._filter.dropped

    @property
    def passes(self) -> int:
        """How many passes have ended."""
        return self._passes

    @property
    def passes_reported(self) -> int:
        """How many of them are in the outbox, by this run of the session or by one that was cut short."""
        return 0 if self._reporter is None else self._reporter.reported + self._reporter.repeated

    @property
    def passes_dropped(self) -> int:
        """How many of them were given up because the disk failed for too long."""
        return 0 if self._reporter is None else self._reporter.dropped

    @property
    def passes_unusable(self) -> int:
        """How many of them no server would take, such as one without a positive definite covariance."""
        return 0 if self._reporter is None else self._reporter.unusable


def _check_start(template: ReportMessage, header: DriveHeader, outbox: Outbox) -> None:
    """Find out at the start of a drive, not at its end, that its reports could not be sent."""
    if header.start_time.tzinfo is None:
        raise SessionError("start_time needs a time zone")
    try:
        check_message(template)
    except WireError as error:
        raise SessionError(error.message) from error
    if outbox.session(template.session_id).closed:
        raise SessionClosedError(f"session {template.session_id} is closed: a new drive needs a new session id")
