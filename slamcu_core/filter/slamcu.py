"""The SLAMCU filter: Dempster-Shafer map management (section 4) around a Rao-Blackwellized particle filter (section 5).

One step follows the paper's Figure 5: predict (eq. 12), pre-associate (4.3.1), update existence (4.3.2), classify
(4.3.3), associate with Normal and New only (4.3.4), weigh (eq. 17-19), update new features (eq. 16), resample (eq. 20).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from slamcu_core.drive import DetectionFrame, DriveHeader, ObjectFrame, Odometry, Record
from slamcu_core.errors import FilterLostError
from slamcu_core.filter import existence
from slamcu_core.filter.beliefs import Beliefs
from slamcu_core.filter.beside import Beside
from slamcu_core.filter.calibration import Calibrations, GnssBias, SensorCalibration
from slamcu_core.filter.closing import PassClosing
from slamcu_core.filter.detections import Instant, read_detections
from slamcu_core.filter.estimates import FeatureEstimate, PoseEstimate
from slamcu_core.filter.fixes import FixWatch
from slamcu_core.filter.frame_handling import FrameHandling, SensorAtWork
from slamcu_core.filter.health import HealthMonitor
from slamcu_core.filter.hindsight import Hindsight
from slamcu_core.filter.intake import Intake
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.outage import Outage
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.passes import PassReporter
from slamcu_core.filter.reckoning import DeadReckoning
from slamcu_core.filter.resampling import resample
from slamcu_core.filter.riders import Riders
from slamcu_core.filter.table import FeatureTable, Vocabulary
from slamcu_core.filter.whereabouts import Whereabouts
from slamcu_core.geometry import LocalFrame, compass_to_math
from slamcu_core.hd_map import HDMap
from slamcu_core.reports import Doubt, Health, PassReport


class SlamcuFilter:
    """Localize a car on an HD map while classifying the map's features and mapping new ones.

    Feed it the records of a drive in order of time; it hands back the passes that ended, without the map's prior.

    Parameters
    ----------
    hd_map : the map, with watch features if any.
    header : where the drive starts, when, and with which sensors.
    parameters : settings.
    rng : the only source of randomness; equal generators and records give equal results.
    """

    def __init__(
        self,
        hd_map: HDMap,
        header: DriveHeader,
        parameters: FilterParameters | None = None,
        *,
        rng: np.random.Generator,
    ) -> None:
        self.parameters = parameters or FilterParameters()
        self._rng = rng
        start = header.initial_pose
        self._names = Vocabulary()
        self._particles = Particles.sample(
            self.parameters.particles,
            self.parameters.max_new,
            position_std=start.position_std_m,
            heading=compass_to_math(start.heading_deg),
            heading_std=float(np.deg2rad(start.heading_std_deg)),
            noise=self.parameters.motion,
            rng=rng,
            sensors=len(header.sensors),
        )
        self._table = FeatureTable()
        reach = max((s.max_range_m + np.hypot(s.mount.x, s.mount.y) for s in header.sensors), default=0.0)
        self._gnss = GnssBias(self.parameters, start.position_std_m)
        self._calibrations = Calibrations(self.parameters, len(header.sensors))
        self._hindsight = Hindsight(
            self._table,
            self._particles,
            gnss=self._gnss,
            calibrations=self._calibrations,
            motion=self.parameters.motion,
            reach=float(reach),
        )
        self._around = Neighbourhood(
            self._table,
            hd_map,
            LocalFrame(start.lon, start.lat),
            self._names,
            hindsight=self._hindsight,
            reach=float(reach),
            kept_finds=self.parameters.kept_finds,
        )
        self._management = MapManagement(self._table, self._around, self._particles, self.parameters)
        self._beliefs = Beliefs(
            hd_map,
            table=self._table,
            particles=self._particles,
            around=self._around,
            calibrations=self._calibrations,
            management=self._management,
            names=self._names,
            parameters=self.parameters,
        )
        self._closing = PassClosing(
            self._table,
            management=self._management,
            beliefs=self._beliefs,
            beside=Beside(hd_map, self._table, self._beliefs, self._management),
            reporter=PassReporter(self._table, hd_map, header.start_time, self._names),
        )
        install = partial(SensorAtWork.install, parameters=self.parameters, names=self._names)
        self._sensors = {
            sensor.id: install(sensor, self._table, self._particles, SensorCalibration(self._calibrations, number))
            for number, sensor in enumerate(header.sensors)
        }
        self._monitor = HealthMonitor(
            self.parameters.detection_concentration, self.parameters.gate, self.parameters.unmapped_share
        )
        self._frames = FrameHandling(
            self._table,
            around=self._around,
            management=self._management,
            monitor=self._monitor,
            unmapped_share=self.parameters.unmapped_share,
            rng=rng,
        )
        self._intake = Intake(header)
        outage = Outage(self._particles, self._gnss, self.parameters.motion, reach=float(reach), rng=rng)
        self._whereabouts = Whereabouts(
            self._table,
            self._particles,
            gnss=self._gnss,
            outage=outage,
            around=self._around,
            management=self._management,
            monitor=self._monitor,
            rng=rng,
        )
        self._reckoning = DeadReckoning(
            self._particles,
            self._hindsight,
            outage,
            noise=self.parameters.motion,
            wheelbase_m=header.wheelbase_m,
            rng=rng,
        )
        self._riders = Riders()
        self._last_frame = 0.0  # s, of any sensor
        self._before_silence: Health | None = None  # under which the last record ended passes, if it broke a silence
        self._lost: str | None = None  # why no record is taken any more

    def feed(self, record: Record) -> list[PassReport]:
        """Take the next record of the drive and return the passes that it ended.

        After a pause of more than 3 s a record waits for the next one, and is dropped if that is of an earlier time.

        Raises ClockError if time runs backwards or leaps ahead by more than an hour, SlamcuError if a sensor is not in
        the header or a value makes no sense (see `check_record`); the filter is then as before. Raises FilterLostError
        if the numbers break down all the same: what is believed is then worth nothing, and no record is taken any more.
        """
        if self._lost is not None:
            raise FilterLostError(self._lost)
        admitted = self._intake.admit(record, self.time)
        self._before_silence = None
        try:
            return [report for one in admitted for report in self._take(one)]
        except (ArithmeticError, ValueError) as error:  # a matrix that is not positive definite is a ValueError
            self._lost = f"the filter is lost at t = {record.t} s, a new session is needed: {error}"
            raise FilterLostError(self._lost) from error

    def _take(self, record: Record) -> list[PassReport]:
        ended = self._fall_silent() if self._reckoning.falls_silent(record.t) else []
        return ended + self._by_kind(record)

    def _by_kind(self, record: Record) -> list[PassReport]:
        if isinstance(record, DetectionFrame):
            return self._frame(record, self._sensors[record.sensor])
        if isinstance(record, ObjectFrame):
            sensor = self._sensors[record.sensor]
            sensor.occluders, sensor.occluders_at = record.items, record.t
        elif isinstance(record, Odometry):
            self._reckoning.tell(record)
        else:
            self._reckoning.advance(record.t)
            self._particles.settle(self._rng)
            if not self._whereabouts.take_fix(record):
                self._resample()
        return []

    def _fall_silent(self) -> list[PassReport]:
        """End what hangs on knowing how the car moves, where odometry was good for the last time."""
        self._reckoning.advance(self._reckoning.holds_until)
        self._reckoning.silent = True
        ended = self._closing.all()
        if ended:
            self._before_silence = self.health
        self._whereabouts.lose_track()
        return ended

    def finish(self) -> list[PassReport]:
        """End the drive: close every open pass and return its report; a filter that is lost has none."""
        self._before_silence = None
        if self._lost is not None:
            return []
        self._reckoning.advance(self.time)
        return self._closing.all()

    def _resample(self) -> None:
        fraction, jitter = self.parameters.resample_fraction, self.parameters.jitter
        if resample(self._particles, fraction, jitter, self._rng, leave_open=self._frames.in_doubt):
            self._hindsight.learn()

    def _frame(self, record: DetectionFrame, sensor: SensorAtWork) -> list[PassReport]:
        seen = read_detections(sensor.model, record.items, self._names)
        share = existence.temper(record.t - sensor.last_frame, self.parameters.correlation_time_s)
        self._reckoning.advance(record.t)
        gap = record.t - self._last_frame
        self._calibrations.predict(self._particles, gap)
        # whatever was in view before so long a silence is met anew, also if it is in view again
        ended = self._closing.out_of_view(record.t) if gap > self.parameters.pass_gap_s else []
        sensor.last_frame = self._last_frame = record.t
        cloud = self._particles.cloud()
        if self._around.reanchor(cloud.mean[:2], self._particles):
            cloud = self._particles.cloud()
        pose = cloud.mean
        self._around.refresh(pose[:2], self._particles)
        if len(record.items):
            seen = seen.without(self._riders.flag(seen, self._reckoning.way))
        occluders = sensor.occluders if record.t - sensor.occluders_at < 0.2 else ()
        fresh = sensor.whiteness.fresh(share)
        now = Instant(record.t, share, fresh, pose, self._reckoning.pose, self._reckoning.speed)
        if self._whereabouts.unknown:
            self._particles.settle(self._rng)
            if not self._reckoning.silent:
                self._whereabouts.look_around(sensor.model, seen, now)
            return ended
        view = sensor.lookout.look(self._around.rows, cloud, seen, occluders)
        if view is not None:
            self._frames.take(sensor, view, seen, now)
            self._resample()
            self._whereabouts.look_around(sensor.model, seen, now)
        else:
            self._particles.settle(self._rng)
        return ended + self._closing.out_of_view(record.t)

    @property
    def time(self) -> float:
        """The time of the last record that was taken, s since the start of the drive."""
        return self._reckoning.time

    @property
    def dropped(self) -> int:
        """Number of records after a pause whose time was wrong, as the next one showed."""
        return self._intake.dropped

    @property
    def pose(self) -> PoseEstimate:
        """The pose at the last record."""
        return self._beliefs.pose(self.time, self._reckoning.travel)

    @property
    def health(self) -> Health:
        """How far the filter trusts itself."""
        effective = self._particles.effective / len(self._particles)
        broken = self._lost is not None or not np.isfinite(self._particles.state).all()
        return self._monitor.state(effective, Doubt.NUMBERS if broken else self._whereabouts.doubt)

    @property
    def health_of_passes(self) -> Health:
        """How far the filter trusted itself when the passes ended that the last record or `finish` has returned.

        It differs from `health` after a silence of all records: they ended before it, on a pose that was known.
        """
        return self._before_silence or self.health

    @property
    def fixes(self) -> FixWatch:
        """What GNSS says of the pose, and how many fixes were refused."""
        return self._whereabouts.fixes

    @property
    def live_rows(self) -> int:
        """Number of features held at work: what a step costs grows with it, and it does not grow with the drive."""
        return self._table.used

    @property
    def live_finds(self) -> int:
        """Number of the car's own finds that every particle maps."""
        return int((self._table.slot >= 0).sum())

    def features(self) -> list[FeatureEstimate]:
        """Return what is believed of every feature of the map, also those never near, and of the car's own finds."""
        return self._beliefs.estimates()
