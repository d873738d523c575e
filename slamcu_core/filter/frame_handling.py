"""One frame through sections 4.3 and 5.2-5.3, from its detections to evidence, weights and finds.

`SlamcuFilter` says when a frame is taken and what becomes of the drive; here is what the frame itself changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Occluder, Sensor
from slamcu_core.filter import existence
from slamcu_core.filter.calibration import Instrument, SensorCalibration
from slamcu_core.filter.careful_update import Occasion, weigh_with_care
from slamcu_core.filter.detectability import DetectionRate, RatesInView
from slamcu_core.filter.detections import Instant, Seen
from slamcu_core.filter.explanations import exclusive, in_doubt, settle_on
from slamcu_core.filter.frame_update import FrameUpdate
from slamcu_core.filter.health import HealthMonitor
from slamcu_core.filter.map_management import MapManagement
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.outline import MeanLook
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.table import FeatureTable, Kind, Vocabulary
from slamcu_core.filter.view import Lookout, View
from slamcu_core.filter.whiteness import Whiteness
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_STALE_S = 2.0  # s without a sighting that weighs the particles, after which they may lie far apart
_SURPRISES = 2  # detections in a frame that fit nothing on the map, and as many more for each that fits something
_SURE = 0.8  # probability of an explanation from which on finds are made and improved by it


@dataclass(slots=True)
class SensorAtWork:
    """A sensor at work, and what is kept of it from frame to frame."""

    instrument: Instrument
    lookout: Lookout
    update: FrameUpdate
    codes: Index  # of the classes that it detects
    rates: DetectionRate
    whiteness: Whiteness
    around: Index | None = None  # the active rows ...
    unmapped: float = 0.0  # ... and the things per m² of ground that the map is believed to lack among them
    last_frame: float = -np.inf
    occluders: tuple[Occluder, ...] = ()
    occluders_at: float = -np.inf

    @property
    def model(self) -> SensorModel:
        """How it measures."""
        return self.instrument.model

    @classmethod
    def install(
        cls,
        sensor: Sensor,
        table: FeatureTable,
        particles: Particles,
        calibration: SensorCalibration,
        *,
        parameters: FilterParameters,
        names: Vocabulary,
    ) -> SensorAtWork:
        """Put a sensor to work on the rows and particles of one drive."""
        model = SensorModel(sensor)
        codes = np.array([names.code(name) for name in sensor.classes], dtype=np.intp)
        parts = model, table, particles, calibration
        return cls(
            Instrument(model, calibration),
            Lookout(*parts, MeanLook(*parts, codes=codes, gate=parameters.gate)),
            FrameUpdate(*parts, parameters),
            codes,
            DetectionRate(sensor.detection_probability, sensor.max_range_m),
            Whiteness(model, parameters.correlation_time_s),
        )


class FrameHandling:
    """Takes the frames of a drive, one after the other, from whichever sensor."""

    def __init__(
        self,
        table: FeatureTable,
        *,
        around: Neighbourhood,
        management: MapManagement,
        monitor: HealthMonitor,
        unmapped_share: float,
        rng: np.random.Generator,
    ) -> None:
        self._table, self._around, self._management, self._monitor = table, around, management, monitor
        self._unmapped_share, self._rng = unmapped_share, rng
        self._weighed_at = self._surprised_at = -np.inf
        self.in_doubt = False  # whether the last frame had detections that may be more than one thing

    def take(self, sensor: SensorAtWork, view: View, seen: Seen, now: Instant) -> None:
        """Take one frame through section 4.3 and 5.2-5.3."""
        table, management, update = self._table, self._management, sensor.update
        if sensor.around is not self._around.rows:
            sensor.around = self._around.rows
            sensor.unmapped = self._unmapped(sensor.model.sensor.max_range_m, now.pose[:2])
        log_unknown = update.log_unknown(seen, sensor.unmapped)
        columns, squares, score = update.pre_associate(view, seen, log_unknown)
        unseen = certain = looked = supported = None
        occasion = self._occasion(view, score, now.t)
        if occasion is not None:
            supported = management.supports(view.rows)
            shares, looked = weigh_with_care(
                update,
                view,
                seen,
                score,
                supported[: view.close],
                log_unknown=log_unknown,
                occasion=occasion,
                share=now.share,
                rng=self._rng,
            )
            shares = exclusive(shares)
            columns, certain = settle_on(shares)
            seen = seen.believed(certain)
            unseen = np.ones(len(view.rows))
            unseen[: view.close] -= np.minimum(np.add.reduce(shares, axis=0), 1.0)
        detections = (columns >= 0).nonzero()[0]
        matched = columns[detections]
        # noise by the expected range: by the measured one, short readings would weigh more than long ones
        seen.noise[:, detections] = view.noise.take(matched, axis=1)
        rates = sensor.rates.within(view.distance)
        management.update_existence(
            sensor.instrument,
            rates,
            view,
            seen,
            (detections, matched),
            now=now,
            unseen=unseen,
            supported=supported,
        )
        # association with Normal and New only (4.3.4), by the classes after this frame's evidence (4.3.3)
        rows = view.rows[matched]
        usable = management.supports(rows)
        self._watch(
            rates, view, matched, squares[detections, matched], usable, alone=len(columns) - len(matched), now=now
        )
        if np.count_nonzero(usable):
            self._weighed_at = now.t
        self._compare(sensor, view, seen, (detections[usable], matched[usable]), now)
        told = detections
        if certain is None:
            matches = update.weigh(view, seen, (detections, matched), usable, share=now.share, rng=self._rng)
        else:
            sure = (certain[detections] > _SURE).nonzero()[0]
            usable, told = usable[sure], detections[sure]
            matches = update.match(view, seen, (told, matched[sure]), looked)
        if len(matches.close.rows):
            update.calibrate(matches, usable, now.fresh)
            update.update_new(matches, now.fresh)
            management.follow_watched(sensor.instrument, seen, (told, matches.close.rows), now)
        if len(rows):
            table.looks_hit[rows] += now.share
        management.forget_refuted(view.rows)
        if len(detections) < len(columns):
            alone = (columns < 0).nonzero()[0]
            known = np.logical_or.reduce(seen.feature_class[alone, None] == sensor.codes, axis=1)
            if certain is not None:
                known &= certain[alone] > _SURE
            management.give_birth(sensor.instrument, seen, alone[known], now)

    def _compare(
        self, sensor: SensorAtWork, view: View, seen: Seen, matched: tuple[Index, Index], now: Instant
    ) -> None:
        """Compare how the map's features (A,) are seen with the last frame."""
        detections, columns = matched
        mapped = (columns < view.mapped).nonzero()[0]
        detections, rows = detections[mapped], view.rows[columns[mapped]]
        sensor.whiteness.learn(
            now,
            self._table.source[rows].tolist(),
            self._table.xy.take(rows, axis=0).T,
            seen.measurement.take(detections, axis=1),
            seen.noise.take(detections, axis=1),
        )

    def _watch(
        self,
        rates: RatesInView,
        view: View,
        matched: Index,
        squares: Array,
        usable: NDArray[np.bool_],
        *,
        alone: int,
        now: Instant,
    ) -> None:
        """Hold what a frame shows against what it should.

        Parameters
        ----------
        rates : of detection of the rows, at their ranges.
        matched : (A,) columns of the view that detections belong to.
        squares : (A,) normalised innovations squared of those.
        usable : (A,) on which of these the car localizes.
        alone : how many detections belong to none.
        """
        mapped = self._table.kind[view.rows] == Kind.MAP
        due = now.share * view.shown * rates.now()
        hit, square = np.zeros(len(view.rows)), np.zeros(len(view.rows))
        hit[matched], square[matched] = now.share, squares
        exists = partial(existence.probability, self._table)
        self._monitor.note(now.t, view.rows, mapped, shown=view.shown, due=due, hit=hit, exists=exists, squares=square)
        self._monitor.observe(
            squares[usable].tolist(),
            len(matched) + alone,
            alone,
            expected=float(np.add.reduce(due[mapped])),
            share=now.share,
        )

    def _unmapped(self, reach_m: float, place: Array) -> float:
        """Return how many things per m² the map may lack: a share of what it has within reach, at least of one."""
        rows = self._around.rows
        mapped = rows[self._table.kind[rows] == Kind.MAP]
        off = self._table.xy.take(mapped, axis=0) - place
        near = np.vecdot(off, off) < reach_m**2
        return self._unmapped_share * max(int(np.count_nonzero(near)), 1) / (np.pi * reach_m**2)

    def _occasion(self, view: View, score: Array, t: float) -> Occasion | None:
        """Return why a frame has to be taken with care; None if it need not be."""
        if not score.size:
            return None
        by_map = score[:, : view.mapped]
        fit = int(np.count_nonzero(np.logical_or.reduce(by_map > 0.0, axis=1)))
        surprised = len(score) - fit >= _SURPRISES * (1 + fit)
        surprised &= t - self._surprised_at > _STALE_S
        stale = t - self._weighed_at > _STALE_S and bool((score > -np.inf).any())
        if not (surprised or stale or in_doubt(score)):
            self.in_doubt = False
            return None
        if surprised:
            self._surprised_at = t
        self.in_doubt = True
        return Occasion(stale, surprised)
