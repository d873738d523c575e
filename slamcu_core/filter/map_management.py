"""Map management, section 4.3: existence, passes, and the car's own finds from their first detection to their end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import existence
from slamcu_core.filter.ekf import birth_covariance
from slamcu_core.filter.existence import State
from slamcu_core.filter.frame_update import Seen, View
from slamcu_core.filter.neighbourhood import Neighbourhood
from slamcu_core.filter.parameters import FilterParameters
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Pairs = list[tuple[int, int]]


@dataclass(frozen=True, slots=True)
class Instant:
    """When and where a frame was taken."""

    t: float  # s since the start of the drive
    share: float  # of the frame's evidence that is its own
    pose: Array  # (3,) mean of the particles
    reckoned: Array  # (3,) pose by dead reckoning: it drifts, but never jumps
    speed: float  # m/s


class MapManagement:
    """Keeps the rows of the feature table: what exists, what is in view, and what the car found itself."""

    def __init__(
        self, table: FeatureTable, around: Neighbourhood, particles: Particles, parameters: FilterParameters
    ) -> None:
        self._table, self._around, self._particles, self._parameters = table, around, particles, parameters
        self._speed = 0.0
        self._votes: dict[int, Counter[tuple[int, int]]] = {}
        self._spare: list[int] = []  # rows of forgotten finds, to be used again
        self.open: set[int] = set()  # rows with an open pass

    def update_existence(self, model: SensorModel, view: View, seen: Seen, pairs: Pairs, now: Instant) -> None:
        """Update existence (4.3.2) by the detections of a frame.

        Detected rows get eq. 1; rows that should have shown themselves and did not get eq. 2.
        """
        table, parameters = self._table, self._parameters
        self._speed = now.speed
        detections, columns = (np.array(side, dtype=np.intp) for side in ([d for d, _ in pairs], [c for _, c in pairs]))
        hit = np.zeros(len(view.rows), dtype=bool)
        hit[columns] = True
        self._keep_passes(view, hit, now.t)
        hit_rows = view.rows[columns]
        existence.add_detections(table, hit_rows, seen.confidence[detections], now.share, parameters.evidence_cap)
        looked = view.visible * (1.0 - view.hidden)
        chance = looked * existence.detectability(
            table, view.rows, model.sensor.detection_probability, parameters.detection_concentration
        )
        missed = ~hit & (view.visible > 0.05)
        existence.add_misses(table, view.rows[missed], chance[missed], parameters, now.share)
        table.looks_missed[view.rows[missed]] += now.share * looked[missed]
        table.hits[hit_rows] += 1
        table.last_hit[hit_rows] = now.t
        for detection, column in pairs:
            self._sight(model, int(view.rows[column]), seen, detection, now)

    def _keep_passes(self, view: View, hit: NDArray[np.bool_], t: float) -> None:
        table = self._table
        looking = hit | (view.visible > 0.5)
        for row in view.rows[looking & ~table.open[view.rows]].tolist():
            table.begin_pass(row, t)
            self.open.add(row)
        blocked = looking & ~hit & (view.hidden > 0.5)
        table.pass_last[view.rows[looking]] = t
        table.detected[view.rows[hit]] += 1
        table.blocked[view.rows[blocked]] += 1
        table.missed[view.rows[looking & ~hit & ~blocked]] += 1

    def _sight(self, model: SensorModel, row: int, seen: Seen, detection: int, now: Instant) -> None:
        """Note where a row was seen, for its report and for whether it stands still."""
        table = self._table
        measured, noise = seen.measurement[detection], seen.noise[detection]
        place = model.invert(now.pose, measured)
        covariance = birth_covariance(model.feature_jacobian(now.pose, place), noise)
        information = np.linalg.inv(covariance)
        table.seen_information[row] += information
        table.seen_vector[row] += information @ place
        table.view_weight[row] += 1.0 / noise[0]
        table.view_from[row] += now.pose[:2] / noise[0]
        if table.kind[row] != Kind.NEW:
            return
        weight, since = 1.0 / noise[0], now.t - table.born[row]
        # by dead reckoning, for a correction of the pose would look like motion
        along = float((model.invert(now.reckoned, measured) - table.origin[row]) @ table.axis[row])
        table.track[row] += weight * np.array([1.0, since, since**2, along, since * along])
        if seen.sign[detection] or seen.value[detection]:
            votes = self._votes.setdefault(row, Counter())
            votes[int(seen.sign[detection]), int(seen.value[detection])] += 1
            table.sign[row], table.value[row] = votes.most_common(1)[0][0]

    def classify(self, rows: Index) -> NDArray[np.str_]:
        """Return the class of rows (4.3.3); a find is New only when it has proven to be one thing that stands still."""
        table = self._table
        proven = existence.stands_still(table, rows, self._speed, self._parameters)
        proven &= existence.shows_itself(table, rows)
        return existence.classify(table, rows, proven | (table.kind[rows] != Kind.NEW) | table.reported[rows])

    def give_birth(self, model: SensorModel, seen: Seen, detection: int, now: Instant) -> None:
        """Register an unassociated detection as a new feature with vacuous existence (eq. 4), in every particle."""
        slot = self._around.free_slot(self._particles)
        if slot is None:
            return
        particles, table = self._particles, self._table
        measured = np.broadcast_to(seen.measurement[detection], (len(particles), 2)).copy()
        if model.has_bearing:
            measured[:, 0] /= 1.0 + particles.calibration[:, 0]
            measured[:, 1] -= particles.calibration[:, 1]
        place = model.invert(particles.pose, measured)
        noise = np.broadcast_to(seen.noise[detection] / now.share, place.shape)
        particles.mean[:, slot] = place
        particles.covariance[:, slot] = birth_covariance(model.feature_jacobian(particles.pose, place), noise)
        codes = {
            "feature_class": int(seen.feature_class[detection]),
            "sign": int(seen.sign[detection]),
            "value": int(seen.value[detection]),
        }
        row = table.reuse(self._spare.pop(), Kind.NEW, **codes) if self._spare else table.add(Kind.NEW, **codes)
        table.slot[row] = slot
        table.nominal[row] = model.sensor.detection_probability
        table.born[row] = table.last_hit[row] = now.t
        table.hits[row] = 1
        table.xy[row] = particles.weights @ place
        table.axis[row] = np.cos(now.reckoned[2]), np.sin(now.reckoned[2])
        table.origin[row] = now.reckoned[:2]
        table.begin_pass(row, now.t)
        table.pass_last[row] = now.t
        table.detected[row] = 1
        self.open.add(row)
        self._sight(model, row, seen, detection, now)
        self._around.rows = np.append(self._around.rows, row)

    def forget_refuted(self, rows: Index) -> None:
        """Forget finds that the evidence speaks against before anybody was told of them."""
        table = self._table
        own = rows[(table.kind[rows] == Kind.NEW) & ~table.reported[rows]]
        for row in own[table.weight_against[own] - table.weight_for[own] > 1.0].tolist():
            self._forget(row)

    def _forget(self, row: int) -> None:
        table = self._table
        table.alive[row] = table.open[row] = False
        table.slot[row] = -1
        self.open.discard(row)
        self._votes.pop(row, None)
        self._spare.append(row)
        self._around.rows = self._around.rows[self._around.rows != row]

    def start_over(self) -> None:
        """Forget what was believed from a wrong pose: the car's own finds, all evidence of the drive, open passes."""
        table = self._table
        for row in np.flatnonzero((table.kind == Kind.NEW) & table.alive).tolist():
            self._forget(row)
        table.weight_for[:] = table.weight_against[:] = 0.0
        table.open[:] = False
        self.open.clear()

    def end_passes(self, rows: Iterable[int]) -> list[int]:
        """End the passes of rows and return those worth a report; finds that never became New are forgotten."""
        table, worth = self._table, []
        for row in rows:
            self.open.discard(row)
            if table.kind[row] == Kind.NEW and not table.reported[row]:
                if self.classify(np.array([row], dtype=np.intp))[0] != State.NEW:
                    self._forget(row)
                    continue
                table.reported[row] = True
            worth.append(row)
        return worth
