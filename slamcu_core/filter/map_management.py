"""Map management, section 4.3: existence, passes, and the car's own finds from their first detection to their end."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import existence, standing
from slamcu_core.filter.calibration import Instrument
from slamcu_core.filter.detectability import RatesInView
from slamcu_core.filter.detections import Instant, Seen
from slamcu_core.filter.ekf import birth_covariance
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.sightings import SightingNotes
from slamcu_core.filter.table import FeatureTable, Kind, Sum
from slamcu_core.filter.view import View

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_FULL_VIEW = 0.95  # probability of being seen if detected, of what the detection rate is learned from
_ROUNDING_S = 1e-6  # of sums of times


class MapManagement:
    """Keeps the rows of the feature table: what exists, what is in view, and what the car found itself."""

    def __init__(
        self, table: FeatureTable, around: Neighbourhood, particles: Particles, parameters: FilterParameters
    ) -> None:
        self._table, self._around, self._particles, self._parameters = table, around, particles, parameters
        self._speed = 0.0
        self._notes = SightingNotes(table)
        self.open: set[int] = set()  # rows with an open pass
        self._none_ends_before = 0.0  # s: no pass can have lasted its gap until then
        self._finds = 0  # of the drive

    def update_existence(
        self,
        sensor: Instrument,
        rates: RatesInView,
        view: View,
        seen: Seen,
        matched: tuple[Index, Index],
        *,
        now: Instant,
        unseen: Array | None = None,
        supported: NDArray[np.bool_] | None = None,
    ) -> None:
        """Update existence (4.3.2) by the detections of a frame.

        Detected rows get eq. 1; rows that should have shown themselves and did not get eq. 2. `matched` are the
        detections (A,) and the columns (A,) of the view that they belong to, `unseen` (F,) the probabilities that no
        detection was of the row, None: none that is not matched; `supported` (F,) what `supports` says of the rows, if
        that has been asked.
        """
        table, parameters = self._table, self._parameters
        self._speed = now.speed
        detections, columns = matched
        rows, hit = view.rows, np.zeros(len(view.rows), dtype=bool)
        hit[columns] = True
        sums = np.zeros((9, len(rows)))
        self._keep_passes(view, hit, now.t, sums)
        held = table.evidence.take(rows, axis=0)
        rate = self._learn_rates(rates, view, hit, now.share, supported)
        chance = existence.detectability(held, rate, parameters.detection_concentration)
        chance *= view.shown
        missed = (view.visible > 0.05) * now.share
        missed[columns] = 0.0
        shown = view.shown
        if unseen is not None:
            missed *= unseen
            shown = shown * unseen
        sums[Sum.PASS_FOR, columns] = now.share * seen.weight[detections]
        np.multiply(missed, existence.miss_weight(chance, parameters.miss_confidence), out=sums[Sum.PASS_AGAINST])
        sums[Sum.PASS_AGAINST] = existence.bounded_by_view(table, rows, held, shown, sums[Sum.PASS_AGAINST])
        sums[: Sum.PASS_FOR] = sums[Sum.PASS_FOR : Sum.LOOKS_HIT]
        np.multiply(missed, view.shown, out=sums[Sum.LOOKS_MISSED])
        existence.add(table, rows, held, sums, parameters.evidence_cap)
        if len(columns):
            hit_rows = rows[columns]
            table.hits[hit_rows] += 1
            self._note(sensor, hit_rows, seen, detections, now)

    def _learn_rates(
        self,
        rates: RatesInView,
        view: View,
        hit: NDArray[np.bool_],
        share: float,
        supported: NDArray[np.bool_] | None,
    ) -> Array:
        """Return how often the sensor detects the rows (F,) at their range, and learn it from those that stand there.

        Those are Normal or New and have been detected often enough before this frame.
        """
        table, rows = self._table, view.rows
        rate = rates.now()
        proven = (view.shown > _FULL_VIEW) & (table.hits[rows] >= self._parameters.minimum_hits)
        if np.count_nonzero(proven):
            proven &= self.supports(rows) if supported is None else supported
            rates.learn(proven, hit, share)
        return rate

    def _keep_passes(self, view: View, hit: NDArray[np.bool_], t: float, sums: Array) -> None:
        """Open passes of what came into view, and count the frame for them in sums (9, F)."""
        table, rows = self._table, view.rows
        looking = view.visible > 0.5
        looking |= hit
        fresh = rows[looking & ~table.open[rows]]
        if len(fresh):
            self._begin_passes(fresh, t)
        table.pass_last[rows[looking]] = t
        sums[Sum.DETECTED] = hit
        looking &= ~hit
        if view.shown is not view.visible:
            blocked = looking & (view.hidden > 0.5)
            sums[Sum.BLOCKED] = blocked
            looking &= ~blocked
        sums[Sum.MISSED] = looking

    def _begin_passes(self, rows: Index, t: float) -> None:
        self._table.begin_passes(rows, t)
        self.open.update(rows.tolist())

    def out_of_view(self, t: float) -> list[int]:
        """Return the rows with an open pass that have been out of view for the gap that ends a pass, in order."""
        if t < self._none_ends_before:
            return []
        rows = self._table.open.nonzero()[0]
        last = self._table.pass_last[rows]
        gap = self._parameters.pass_gap_s
        gone = t - last > gap
        ended: list[int] = rows[gone].tolist()
        if not ended and len(last):
            self._none_ends_before = float(np.minimum.reduce(last)) + gap - _ROUNDING_S
        return ended

    def supports(self, rows: Index) -> NDArray[np.bool_]:
        """Return whether rows are classed Normal or New (4.3.3), so that the car may localize on them (4.3.4)."""
        table, kind = self._table, self._table.kind[rows]
        usable = existence.exists(table, rows)
        usable &= kind != Kind.WATCH
        usable &= ~table.disputed[rows]
        unproven = usable & (kind == Kind.NEW)
        unproven &= ~table.reported[rows]
        own = unproven.nonzero()[0]
        if len(own):
            usable[own] = self._proven(rows[own])
        return np.asarray(usable)

    def _proven(self, rows: Index) -> NDArray[np.bool_]:
        """Return whether finds have proven to be one thing that stands still."""
        stands = standing.stands_still(self._table, rows, self._speed, self._parameters)
        if not np.count_nonzero(stands):
            return stands
        return np.asarray(stands & existence.shows_itself(self._table, rows))

    def classify(self, rows: Index) -> NDArray[np.str_]:
        """Return the class of rows (4.3.3); a find is New only when it has proven to be one thing that stands still."""
        table = self._table
        return existence.classify(
            table, rows, self._proven(rows) | (table.kind[rows] != Kind.NEW) | table.reported[rows]
        )

    def give_birth(self, sensor: Instrument, seen: Seen, alone: Index, now: Instant) -> None:
        """Register unassociated detections as new features with vacuous existence (eq. 4), in every particle."""
        slots = self._around.free_slots(self._particles)[: len(alone)]
        alone = alone[: len(slots)]
        if not len(alone):
            return
        table = self._table
        places = self._put(sensor, seen, alone, slots, now)
        rows = table.take(len(alone))
        table.kind[rows], table.slot[rows] = Kind.NEW, slots
        table.feature_class[rows] = seen.feature_class[alone]
        table.sign[rows], table.value[rows] = seen.sign[alone], seen.value[alone]
        table.nominal[rows] = sensor.model.sensor.detection_probability
        table.born[rows] = now.t
        table.number[rows] = self._finds + 1 + np.arange(len(rows))
        self._finds += len(rows)
        table.hits[rows] = 1
        table.xy[rows] = (places @ self._particles.weights).T
        table.axis[rows] = math.cos(now.reckoned[2]), math.sin(now.reckoned[2])
        table.origin[rows] = now.reckoned[:2]
        self._begin_passes(rows, now.t)
        table.pass_last[rows] = now.t
        table.detected[rows] = 1
        self._note(sensor, rows, seen, alone, now)
        self._around.rows = np.concatenate([self._around.rows, rows])

    def _note(self, sensor: Instrument, rows: Index, seen: Seen, detections: Index, now: Instant) -> None:
        beyond = sensor.calibration.beyond_the_first(self._particles)
        self._notes.add(sensor.model, rows, seen, detections, now=now, beyond=beyond)

    def follow_watched(self, sensor: Instrument, seen: Seen, matched: tuple[Index, Index], now: Instant) -> None:
        """Let the particles place the watch features among detected rows (A,) from their first sighting of a pass on.

        So what corrects the pose later corrects the place that is reported, as it does for a find.
        """
        detections, rows = matched
        table = self._table
        new = ((table.kind[rows] == Kind.WATCH) & (table.slot[rows] < 0)).nonzero()[0]
        if len(new):
            slots = self._around.free_slots(self._particles)[: len(new)]
            new = new[: len(slots)]
            self._put(sensor, seen, detections[new], slots, now)
            table.slot[rows[new]] = slots

    def _put(self, sensor: Instrument, seen: Seen, detections: Index, slots: Index, now: Instant) -> Array:
        """Place detections (A,) in slots of every particle, and return where, (2, A, M)."""
        particles = self._particles
        measured = np.empty((2, len(detections), len(particles)))
        measured[:] = seen.measurement[:, detections, None]
        if sensor.model.has_bearing:
            scale, turn = sensor.calibration.means(particles)
            measured[0] /= 1.0 + scale
            measured[1] -= turn
        places, by_feature = sensor.model.born(particles.pose, measured)
        particles.means[:, slots] = places
        particles.covariances[:, slots] = birth_covariance(by_feature, seen.noise[:, detections, None] / now.fresh)
        return places

    def forget_refuted(self, rows: Index) -> None:
        """Forget finds that the evidence speaks against before anybody was told of them."""
        table = self._table
        own = rows[(table.kind[rows] == Kind.NEW) & ~table.reported[rows]]
        if not len(own):
            return
        refuted = table.weight_against[own] - table.weight_for[own] > 1.0
        if np.count_nonzero(refuted):
            for row in own[refuted].tolist():
                self.forget(row)

    def forget(self, row: int) -> None:
        """Forget a find."""
        self.open.discard(row)
        self._notes.forget(row)
        self._table.release(row)
        self._around.rows = self._around.rows[self._around.rows != row]

    def unite(self, mapped: int, find: int) -> None:
        """Give a feature of the map what a find in its place has shown, and forget the find.

        The misses of the feature's open pass are taken back: it was seen, as the find.
        """
        table = self._table
        if not table.open[mapped]:
            self._begin_passes(np.array([mapped], dtype=np.intp), float(table.pass_start[find]))
            table.pass_last[mapped] = table.pass_last[find]
        held, one = table.evidence[[mapped]], np.array([mapped], dtype=np.intp)
        held[0, Sum.WEIGHT_AGAINST] = max(held[0, Sum.WEIGHT_AGAINST] - held[0, Sum.PASS_AGAINST], 0.0)
        held[0, [Sum.PASS_AGAINST, Sum.LOOKS_MISSED, Sum.MISSED]] = 0.0
        existence.add(table, one, held, table.evidence[find][:, None], self._parameters.evidence_cap)
        table.sighted[mapped] += table.sighted[find]
        table.hits[mapped] += table.hits[find]
        table.pass_start[mapped] = min(table.pass_start[mapped], table.pass_start[find])
        table.pass_last[mapped] = max(table.pass_last[mapped], table.pass_last[find])
        self.forget(find)

    def recognize(self, mapped: int, find: int) -> None:
        """Give a feature of the map what a find has shown, but not where, and forget the find and all misses."""
        table = self._table
        table.weight_for[mapped] = min(table.weight_for[mapped] + table.weight_for[find], self._parameters.evidence_cap)
        table.evidence[mapped, Sum.WEIGHT_AGAINST :] = 0.0
        table.hits[mapped] += table.hits[find]
        table.open[mapped] = False
        self.open.discard(mapped)
        self.forget(find)

    def start_over(self) -> None:
        """Forget what was believed from a wrong pose: the car's own finds, all evidence of the drive, open passes."""
        table = self._table
        for row in ((table.kind == Kind.NEW) & table.alive).nonzero()[0].tolist():
            self.forget(row)
        table.weight_for[:] = table.weight_against[:] = 0.0
        self._around.forget_behind()
        self.drop_passes()

    def drop_passes(self) -> None:
        """Drop all open passes, of which no report is made."""
        table = self._table
        table.open[:] = False
        table.slot[table.kind == Kind.WATCH] = -1
        self.open.clear()

    def end_passes(self, rows: Iterable[int]) -> list[int]:
        """End the passes of rows and return those worth a report; finds that never became New are forgotten."""
        table, worth = self._table, []
        for row in rows:
            self.open.discard(row)
            if table.kind[row] == Kind.NEW and not table.reported[row]:
                one = np.array([row], dtype=np.intp)
                if not (existence.exists(table, one) & self._proven(one))[0]:
                    self.forget(row)
                    continue
                table.reported[row] = True
            worth.append(row)
        return worth
