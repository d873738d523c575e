"""The SLAMCU filter: Dempster-Shafer map management (section 4) around a Rao-Blackwellized particle filter (section 5).

One step follows the paper's Figure 5: predict (eq. 12), pre-associate (4.3.1), update existence (4.3.2), classify
(4.3.3), associate with Normal and New only (4.3.4), weigh (eq. 17-19), update new features (eq. 16), resample (eq. 20).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import DetectionFrame, DriveHeader, GnssFix, ObjectFrame, Occluder, Odometry, Record
from slamcu_core.errors import SlamcuError
from slamcu_core.evidence import Masses, conflict, support
from slamcu_core.filter import existence
from slamcu_core.filter.calibration import GnssBias, SensorCalibration
from slamcu_core.filter.ekf import birth_covariance
from slamcu_core.filter.estimates import FeatureEstimate, PoseEstimate
from slamcu_core.filter.existence import State
from slamcu_core.filter.frame_update import FrameUpdate, Seen, View, read_detections
from slamcu_core.filter.health import HealthMonitor
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.passes import PassReporter, measured_position
from slamcu_core.filter.prediction import Travel, predict
from slamcu_core.filter.resampling import resample
from slamcu_core.filter.table import FeatureTable, Kind, Vocabulary
from slamcu_core.geometry import LocalFrame, compass_to_math, math_to_compass
from slamcu_core.hd_map import HDMap
from slamcu_core.models import SensorModel, advance, yaw_rate_from_steering
from slamcu_core.reports import Health, PassReport

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(slots=True)
class _Sensor:
    """A sensor at work."""

    model: SensorModel
    update: FrameUpdate
    classes: frozenset[int]
    last_frame: float = -np.inf
    occluders: tuple[Occluder, ...] = ()
    occluders_at: float = -np.inf


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
        self._map, self._header, self._rng = hd_map, header, rng
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
        )
        self._table = FeatureTable()
        reach = max((s.max_range_m + np.hypot(s.mount.x, s.mount.y) for s in header.sensors), default=0.0)
        self._around = Neighbourhood(self._table, hd_map, LocalFrame(start.lon, start.lat), self._names, float(reach))
        self._reporter = PassReporter(self._table, hd_map, header.start_time, self._names)
        self._gnss = GnssBias(self.parameters)
        self._calibration = SensorCalibration(self.parameters)
        self._sensors = {sensor.id: self._install(SensorModel(sensor)) for sensor in header.sensors}
        self._monitor = HealthMonitor()
        self._time = 0.0
        self._speed = 0.0
        self._yaw_rate = 0.0
        self._travel = Travel()
        self._reckoned = np.zeros((1, 3))  # dead reckoning: drifts, but never jumps
        self._open: set[int] = set()
        self._spare: list[int] = []  # rows of dropped finds, to be used again
        self._votes: dict[int, Counter[tuple[int, int]]] = {}

    def _install(self, model: SensorModel) -> _Sensor:
        update = FrameUpdate(model, self._table, self._particles, self._calibration, self.parameters)
        return _Sensor(model, update, frozenset(self._names.code(name) for name in model.sensor.classes))

    # --- what comes in ---------------------------------------------------------------------------------------------

    def feed(self, record: Record) -> list[PassReport]:
        """Take the next record of the drive and return the passes that it ended.

        Raises SlamcuError if time runs backwards, a sensor is not in the header, or a detection lacks what its sensor
        measures; the filter is then as before.
        """
        if not record.t >= self._time:
            raise SlamcuError(f"time runs backwards: t = {record.t} s after {self._time} s")
        if isinstance(record, Odometry):
            self._odometry(record)
            return []
        if isinstance(record, GnssFix):
            self._advance(record.t)
            self._particles.settle(self._rng)
            fix = self._around.frame.to_local(record.lon, record.lat)
            self._gnss.update(self._particles, record.t, fix, record.std_m)
            self._resample()
            return []
        sensor = self._sensors.get(record.sensor)
        if sensor is None:
            raise SlamcuError(f"sensor {record.sensor!r} is not in the header, which has {sorted(self._sensors)}")
        if isinstance(record, ObjectFrame):
            sensor.occluders, sensor.occluders_at = record.items, record.t
            return []
        return self._frame(record, sensor)

    def finish(self) -> list[PassReport]:
        """End the drive: close every open pass and return its report."""
        self._advance(self._time)
        return self._close(sorted(self._open))

    def _odometry(self, record: Odometry) -> None:
        if record.yaw_rate is None:
            if record.steering is None:
                raise SlamcuError("odometry needs yaw_rate or steering")
            yaw_rate = yaw_rate_from_steering(record.speed, record.steering, self._header.wheelbase_m)
        else:
            yaw_rate = record.yaw_rate
        self._accumulate(record.t)
        self._speed, self._yaw_rate = record.speed, yaw_rate
        if self._travel.full:
            self._predict()

    def _accumulate(self, t: float) -> None:
        self._travel.add(self._speed, self._yaw_rate, t - self._time)
        self._time = t

    def _predict(self) -> None:
        predict(self._particles, self._travel, self.parameters.motion, self._rng)
        travel = self._travel
        self._reckoned = advance(self._reckoned, np.array([travel.distance]), np.array([travel.turn]))
        self._travel = Travel()

    def _advance(self, t: float) -> None:
        self._accumulate(t)
        self._predict()

    def _resample(self) -> None:
        resample(self._particles, self.parameters.resample_fraction, self.parameters.jitter, self._rng)

    # --- one frame -------------------------------------------------------------------------------------------------

    def _frame(self, record: DetectionFrame, sensor: _Sensor) -> list[PassReport]:
        seen = read_detections(sensor.model, record.items, self._names)
        if record.t <= sensor.last_frame:
            raise SlamcuError(f"sensor {record.sensor!r} has two frames at t = {record.t} s")
        share = existence.temper(record.t - sensor.last_frame, self.parameters.correlation_time_s)
        self._advance(record.t)
        self._calibration.predict(self._particles, min(record.t - max(sensor.last_frame, 0.0), 1e6))
        sensor.last_frame = record.t
        mean_state, _ = self._particles.mean_state()
        if self._around.reanchor(mean_state[:2], self._particles):
            mean_state, _ = self._particles.mean_state()
        self._around.refresh(mean_state[:2], self._particles)
        rows = self._reachable(sensor, mean_state[:3])
        if len(rows) or len(record.items):
            weights = self._particles.weights
            occluders = sensor.occluders if record.t - sensor.occluders_at < 0.2 else ()
            view = sensor.update.look(rows, weights, mean_state[:3], occluders)
            self._manage(sensor, view, seen, share, mean_state[:3])
            self._resample()
        else:
            self._particles.settle(self._rng)
        gone = [row for row in self._open if record.t - self._table.pass_last[row] > self.parameters.pass_gap_s]
        return self._close(sorted(gone))

    def _reachable(self, sensor: _Sensor, pose: Array) -> Index:
        """Return the active rows that the sensor could see from near the mean pose."""
        rows = self._around.rows
        if not len(rows):
            return rows
        table, spec = self._table, sensor.model.sensor
        xy = table.xy[rows]
        own = table.slot[rows] >= 0
        if own.any():
            xy[own] = self._particles.mean[:, table.slot[rows[own]]].mean(axis=0)
        distance, bearing = sensor.model.polar(pose, xy)
        near = distance < spec.max_range_m + 10.0
        ahead = (np.abs(bearing) < np.deg2rad(spec.fov_deg) / 2.0 + 0.2) | (distance < 5.0)
        fits = np.isin(table.feature_class[rows], list(sensor.classes))
        return np.asarray(rows[near & ahead & fits & table.alive[rows]])

    def _manage(self, sensor: _Sensor, view: View, seen: Seen, share: float, pose: Array) -> None:
        table, parameters, t = self._table, self.parameters, self._time
        columns, squares = sensor.update.pre_associate(view, seen)
        pairs = [(d, int(c)) for d, c in enumerate(columns) if c >= 0]
        for detection, column in pairs:
            # noise by the expected range: by the measured one, short readings would weigh more than long ones
            seen.noise[detection] = sensor.model.noise(view.marginal.mean[column])
        hit = np.zeros(len(view.rows), dtype=bool)
        hit[[c for _, c in pairs]] = True
        self._keep_passes(view, hit)
        # existence (4.3.2): detected rows get eq. 1, rows that should have shown themselves and did not get eq. 2
        hit_rows = view.rows[[c for _, c in pairs]]
        existence.add_detections(
            table, hit_rows, seen.confidence[[d for d, _ in pairs]], share, parameters.evidence_cap
        )
        looked = view.visible * (1.0 - view.hidden)
        chance = looked * existence.detectability(
            table, view.rows, sensor.model.sensor.detection_probability, parameters.detection_concentration
        )
        missed = ~hit & (view.visible > 0.05)
        existence.add_misses(table, view.rows[missed], chance[missed], parameters, share)
        table.looks_missed[view.rows[missed]] += share * looked[missed]
        table.hits[hit_rows] += 1
        table.last_hit[hit_rows] = t
        for detection, column in pairs:
            self._sight(sensor.model, int(view.rows[column]), seen, detection, pose)
        # classification (4.3.3) and association with Normal and New only (4.3.4)
        state = existence.classify(table, hit_rows, self._stands(hit_rows))
        usable = ((state == State.NORMAL) | (state == State.NEW)) & (table.kind[hit_rows] != Kind.WATCH)
        mapped = table.kind[view.rows] == Kind.MAP
        self._monitor.observe(
            [float(squares[d, c]) for (d, c), use in zip(pairs, usable, strict=True) if use],
            len(columns),
            int((columns < 0).sum()),
            float(chance[mapped].sum()),
            int((hit & mapped).sum()),
        )
        mine = table.kind[hit_rows] == Kind.NEW
        sensor.update.weigh(view, seen, list(compress(pairs, usable)), share, self._rng)
        sensor.update.calibrate(view, seen, list(compress(pairs, usable & ~mine)), share)
        sensor.update.update_new(view, seen, list(compress(pairs, mine)), share)
        table.looks_hit[hit_rows] += share
        self._drop_refuted(view.rows)
        for alone in np.flatnonzero(columns < 0).tolist():
            self._give_birth(sensor, seen, alone, share, pose)

    def _keep_passes(self, view: View, hit: NDArray[np.bool_]) -> None:
        table, t = self._table, self._time
        looking = hit | (view.visible > 0.5)
        for row in view.rows[looking & ~table.open[view.rows]].tolist():
            table.begin_pass(row, t)
            self._open.add(row)
        blocked = looking & ~hit & (view.hidden > 0.5)
        table.pass_last[view.rows[looking]] = t
        table.detected[view.rows[hit]] += 1
        table.blocked[view.rows[blocked]] += 1
        table.missed[view.rows[looking & ~hit & ~blocked]] += 1

    def _sight(self, model: SensorModel, row: int, seen: Seen, detection: int, pose: Array) -> None:
        """Note where a row was seen, for its report and for whether it stands still."""
        table, t = self._table, self._time
        measured, noise = seen.measurement[detection], seen.noise[detection]
        place = model.invert(pose, measured)
        covariance = birth_covariance(model.feature_jacobian(pose, place), noise)
        information = np.linalg.inv(covariance)
        table.seen_information[row] += information
        table.seen_vector[row] += information @ place
        table.view_weight[row] += 1.0 / noise[0]
        table.view_from[row] += pose[:2] / noise[0]
        if table.kind[row] == Kind.NEW:
            weight, since = 1.0 / noise[0], t - table.born[row]
            # by dead reckoning, for a correction of the pose would look like motion
            along = float((model.invert(self._reckoned[0], measured) - table.origin[row]) @ table.axis[row])
            table.track[row] += weight * np.array([1.0, since, since**2, along, since * along])
            if seen.sign[detection] or seen.value[detection]:
                votes = self._votes.setdefault(row, Counter())
                votes[int(seen.sign[detection]), int(seen.value[detection])] += 1
                table.sign[row], table.value[row] = votes.most_common(1)[0][0]

    def _stands(self, rows: Index) -> NDArray[np.bool_]:
        proven = existence.stands_still(self._table, rows, self._speed, self.parameters)
        proven &= existence.shows_itself(self._table, rows)
        return np.asarray(proven | (self._table.kind[rows] != Kind.NEW) | self._table.reported[rows])

    # --- the car's own finds ---------------------------------------------------------------------------------------

    def _give_birth(self, sensor: _Sensor, seen: Seen, detection: int, share: float, pose: Array) -> None:
        """Register an unassociated detection as a new feature with vacuous existence (eq. 4), in every particle."""
        if seen.feature_class[detection] not in sensor.classes:
            return
        slot = self._around.free_slot(self._particles)
        if slot is None:
            return
        particles, table, model = self._particles, self._table, sensor.model
        measured = np.broadcast_to(seen.measurement[detection], (len(particles), 2)).copy()
        if model.has_bearing:
            measured[:, 0] /= 1.0 + particles.calibration[:, 0]
            measured[:, 1] -= particles.calibration[:, 1]
        place = model.invert(particles.pose, measured)
        particles.mean[:, slot] = place
        particles.covariance[:, slot] = birth_covariance(
            model.feature_jacobian(particles.pose, place), np.broadcast_to(seen.noise[detection] / share, place.shape)
        )
        codes = {
            "feature_class": int(seen.feature_class[detection]),
            "sign": int(seen.sign[detection]),
            "value": int(seen.value[detection]),
        }
        row = table.add(Kind.NEW, **codes) if not self._spare else table.reuse(self._spare.pop(), Kind.NEW, **codes)
        table.slot[row] = slot
        table.nominal[row] = model.sensor.detection_probability
        table.born[row] = table.last_hit[row] = self._time
        table.hits[row] = 1
        table.xy[row] = particles.weights @ place
        heading = self._reckoned[0, 2]
        table.axis[row] = np.cos(heading), np.sin(heading)
        table.origin[row] = self._reckoned[0, :2]
        table.begin_pass(row, self._time)
        table.pass_last[row] = self._time
        table.detected[row] = 1
        self._open.add(row)
        self._sight(model, row, seen, detection, pose)
        self._around.rows = np.append(self._around.rows, row)

    def _drop_refuted(self, rows: Index) -> None:
        """Forget finds that the evidence speaks against before anybody was told of them."""
        table = self._table
        own = rows[(table.kind[rows] == Kind.NEW) & ~table.reported[rows]]
        for row in own[table.weight_against[own] - table.weight_for[own] > 1.0].tolist():
            self._drop(row)

    def _drop(self, row: int) -> None:
        table = self._table
        table.alive[row] = table.open[row] = False
        table.slot[row] = -1
        self._open.discard(row)
        self._votes.pop(row, None)
        self._spare.append(row)
        self._around.rows = self._around.rows[self._around.rows != row]

    # --- what goes out ---------------------------------------------------------------------------------------------

    def _close(self, rows: list[int]) -> list[PassReport]:
        """End the passes of rows; finds that never became New are forgotten without a word."""
        table, reports = self._table, []
        for row in rows:
            self._open.discard(row)
            index = np.array([row], dtype=np.intp)
            if table.kind[row] == Kind.NEW and not table.reported[row]:
                if existence.classify(table, index, self._stands(index))[0] != State.NEW:
                    self._drop(row)
                    continue
                table.reported[row] = True
            place = None
            if table.detected[row] or table.kind[row] == Kind.NEW:
                place = measured_position(self._around.frame, *self._place(row))
            reports.append(self._reporter.report(row, place))
        return reports

    def _place(self, row: int) -> tuple[Array, Array]:
        """Return where a row is by the car's own measurements: mean (2,) and covariance (2, 2), pose included."""
        table = self._table
        if table.kind[row] == Kind.NEW:
            if table.slot[row] >= 0:
                xy, covariance = self._particles.collapse(int(table.slot[row]))
            else:
                xy, covariance = table.xy[row].copy(), table.covariance[row].copy()
        else:
            inverse = np.linalg.inv(table.seen_information[row])
            _, state_covariance = self._particles.mean_state()
            xy, covariance = inverse @ table.seen_vector[row], inverse + state_covariance[:2, :2]
        if table.view_weight[row] > 0.0:
            line = xy - table.view_from[row] / table.view_weight[row]
            across = np.array([-line[1], line[0]])
            range_variance = self._calibration.variance[0] + self.parameters.pass_range_std**2
            covariance = covariance + range_variance * np.outer(line, line)
            covariance += self._calibration.variance[1] * np.outer(across, across)
        return xy, covariance

    @property
    def pose(self) -> PoseEstimate:
        """The pose at the last record."""
        mean, covariance = self._particles.mean_state()
        # what was driven since the last frame is added here, not to the particles: to ask is not to act
        ahead = np.array([self._travel.distance * mean[3]]), np.array([self._travel.turn * mean[4]])
        mean[:3] = advance(mean[None, :3], *ahead)[0]
        lon, lat = self._around.frame.to_geographic(mean[:2])
        return PoseEstimate(
            self._time,
            float(lon),
            float(lat),
            math_to_compass(float(mean[2])),
            (float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])),
            float(np.rad2deg(np.sqrt(covariance[2, 2]))),
        )

    @property
    def health(self) -> Health:
        """How far the filter trusts itself."""
        return self._monitor.state(self._particles.effective / len(self._particles))

    def features(self) -> list[FeatureEstimate]:
        """Return what is believed of every feature of the map, also those never near, and of the car's own finds."""
        rows = [self._around.row_of(index) for index in range(len(self._map))]
        own = np.flatnonzero((self._table.kind == Kind.NEW) & self._table.alive).tolist()
        return [self._estimate(row, index) for index, row in enumerate(rows)] + [self._estimate(row, -1) for row in own]

    def _estimate(self, row: int | None, index: int) -> FeatureEstimate:
        feature = self._map.features[index] if index >= 0 else None
        table = self._table
        if row is None:
            assert feature is not None  # noqa: S101 - only map features are listed without a row
            prior = 0.0 if feature.watched else float(support(feature.existence_confidence))
            state = State.NORMAL if prior > np.log(2.0) else State.UNCLASSIFIED
            f, a, passes = prior, 0.0, 0
        else:
            one = np.array([row], dtype=np.intp)
            state = State(str(existence.classify(table, one, self._stands(one))[0]))
            f, a = float(table.prior[row] + table.weight_for[row]), float(table.weight_against[row])
            passes = int(table.passes[row])
        if feature is not None:
            variance = feature.position_std_m**2
            place = (feature.lon, feature.lat, (variance, 0.0, variance))
            what = (feature.feature_class, feature.sign, feature.value)
        else:
            assert row is not None  # noqa: S101 - own finds have a row
            found = measured_position(self._around.frame, *self._place(row))
            place = (found.lon, found.lat, found.covariance_m2)
            codes = int(table.feature_class[row]), int(table.sign[row]), int(table.value[row])
            what = (self._names.name(codes[0]) or "", self._names.name(codes[1]), self._names.name(codes[2]))
        return FeatureEstimate(
            feature, state.value, Masses.from_weights(f, a), float(conflict(f, a)), *place, passes, *what
        )
