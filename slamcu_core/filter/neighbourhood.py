"""Which rows are within reach: the map by tile, and the car's own finds, so that a step never sees the whole map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcu_core.evidence import support_of
from slamcu_core.filter.archive import FoundArchive, MapLedger
from slamcu_core.filter.ekf import turned
from slamcu_core.filter.hindsight import Hindsight
from slamcu_core.filter.moving import move_particles, move_sightings, rotation_by
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.table import FeatureTable, Kind, Vocabulary
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap

Array = NDArray[np.float64]

_STEP_M = 30.0  # how far the car may move before the neighbourhood is looked up again
# Beyond the sensors' reach: a find this far away leaves the particles at the latest, earlier if they hold many.
_KEEP_M, _KEEP_CROWDED_M = 500.0, 150.0
# And this far away it no longer follows what corrects the pose: it takes some signs of the map to know the pose well.
_FOLLOW_M = 2_000.0
_REANCHOR_M = 15_000.0  # the local frame is flat enough up to here


class Neighbourhood:
    """Keeps the rows near the car active and the rest cheap."""

    def __init__(
        self,
        table: FeatureTable,
        hd_map: HDMap,
        frame: LocalFrame,
        names: Vocabulary,
        *,
        hindsight: Hindsight,
        reach: float,
        kept_finds: int,
    ) -> None:
        self._hindsight = hindsight
        self._table, self._map, self._names, self._reach = table, hd_map, names, reach
        self.frame = frame
        self.rows: NDArray[np.intp] = np.zeros(0, dtype=np.intp)  # the map's first; replaced, never changed in place
        self._row_of: dict[int, int] = {}
        self.ledger = MapLedger(len(hd_map))
        self.found = FoundArchive(kept_finds)
        self._centre: Array | None = None

    def row_of(self, index: int) -> int | None:
        """Return the row of a map feature by its index, if the car is near it."""
        return self._row_of.get(index)

    def refresh(self, place: Array, particles: Particles, *, force: bool = False) -> bool:
        """Look up again what is near a place (2,) m if the car has moved; return whether the rows changed."""
        if not force and self._centre is not None and math.dist(place, self._centre) < _STEP_M:
            return False
        self._centre = place.copy()
        lon, lat = self.frame.to_geographic(place)
        near = self._map.near(float(lon), float(lat), self._reach + 2.0 * _STEP_M)
        mapped = self._mapped(near)
        self.rows = np.concatenate([mapped, self._own(place, particles)])
        self._leave_behind(near)
        return True

    def _leave_behind(self, near: NDArray[np.intp]) -> None:
        """Free the rows of features that are no longer near, once their passes have ended."""
        table = self._table
        gone = [index for index in self._row_of.keys() - set(near.tolist()) if not table.open[self._row_of[index]]]
        rows = np.array([self._row_of.pop(index) for index in gone], dtype=np.intp)
        self.ledger.put(table, rows)
        for row in rows.tolist():
            table.release(row)

    def forget_behind(self) -> None:
        """Forget what is believed of features left behind."""
        self.ledger.clear()
        self.found.clear()

    def _mapped(self, indices: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the rows of map features, made for those that the car has not been near before."""
        new = [index for index in indices.tolist() if index not in self._row_of]
        if new:
            self._add(new)
        return np.array([self._row_of[index] for index in indices.tolist()], dtype=np.intp)

    def _add(self, indices: list[int]) -> None:
        """Take features of the map into the table."""
        table, code, features = self._table, self._names.code, [self._map.features[index] for index in indices]
        rows = table.take(len(indices))
        table.kind[rows] = [Kind.WATCH if feature.watched else Kind.MAP for feature in features]
        table.feature_class[rows] = [code(feature.feature_class) for feature in features]
        table.sign[rows] = [code(feature.sign) for feature in features]
        table.value[rows] = [code(feature.value) for feature in features]
        table.disputed[rows] = [self._map.is_disputed(feature) for feature in features]
        table.prior[rows] = [support_of(self._map.prior(feature)) for feature in features]
        table.source[rows] = indices
        table.xy[rows] = self.frame.to_local(*self._map.lonlat[indices].T)
        variance = np.array([feature.position_std_m for feature in features]) ** 2
        table.covariance[rows] = variance[:, None] * [1.0, 0.0, 1.0]
        self.ledger.restore(table, rows)
        self._row_of.update(zip(indices, rows.tolist(), strict=True))

    def _own(self, place: Array, particles: Particles) -> NDArray[np.intp]:
        """Return the car's own finds that are near; wake those that came back, collapse those left behind."""
        table = self._table
        lon, lat = (float(value) for value in self.frame.to_geographic(place))
        kept = self.found.near(lon, lat, self._reach + 2.0 * _STEP_M)
        if kept:
            away = np.hypot(*(self.found.places(kept, self.frame) - place).T)
            for index in (away < self._reach + 2.0 * _STEP_M).nonzero()[0].tolist():
                self.found.give_back(kept[index], table, self.frame)
        own = ((table.kind == Kind.NEW) & table.alive).nonzero()[0]
        live = table.slot[own] >= 0
        if len(own):
            weights = particles.weights
            table.xy[own[live]] = (particles.means[:, table.slot[own[live]]] @ weights).T
        distance = np.hypot(*(table.xy[own] - place).T)
        crowded = 2 * int(live.sum()) > particles.means.shape[1]
        far = distance > self._reach + (_KEEP_CROWDED_M if crowded else _KEEP_M)
        behind = own[live & far]
        if len(behind):
            self._collapse(behind, particles)
        for row in own[~live & (distance < self._reach + 2.0 * _STEP_M)]:
            for slot in self.free_slots(particles)[:1]:
                self._hindsight.recall(row, slot)
        done = far & (table.slot[own] < 0) & ~table.open[own]
        done &= (distance > self._reach + _FOLLOW_M) | ~self._hindsight.follows(own)
        for row in own[done].tolist():
            self.found.put(table, row, self.frame)
        return np.asarray(own[table.slot[own] >= 0])

    def let_go(self) -> None:
        """Leave the finds that were left behind where they are, whatever is learnt of the pose."""
        self._hindsight.let_go()

    def part_finds(self, place: Array, particles: Particles) -> None:
        """Take the car's finds from the particles' poses: what is near a place (2,) m is the same for all of them."""
        table = self._table
        self._collapse(((table.slot >= 0) & (table.kind == Kind.NEW)).nonzero()[0], particles)
        self.let_go()
        self.refresh(place, particles, force=True)

    def _collapse(self, rows: NDArray[np.intp], particles: Particles) -> None:
        """Take finds out of the particles."""
        table = self._table
        means, covariances = particles.collapse(table.slot[rows])
        table.xy[rows], table.covariance[rows] = means.T, covariances.T
        table.slot[rows] = -1

    def free_slots(self, particles: Particles) -> NDArray[np.intp]:
        """Return the slots of the particles' arrays that no row uses."""
        taken = np.zeros(particles.means.shape[1] + 1, dtype=bool)
        taken[self._table.slot] = True  # rows without one, which say -1, take the last
        return (~taken[:-1]).nonzero()[0]

    def reanchor(self, place: Array, particles: Particles) -> bool:
        """Move the local frame to `place` if that is far from its anchor, carrying rows and particles along."""
        if math.hypot(*place) < _REANCHOR_M:
            return False
        lon, lat = self.frame.to_geographic(place)
        old, new = self.frame, LocalFrame(float(lon), float(lat))
        ahead = new.to_local(*old.to_geographic(place + np.array([1.0, 0.0])))
        turn = float(np.arctan2(ahead[1], ahead[0]))

        def move(xy: Array) -> Array:
            return new.to_local(*old.to_geographic(xy))

        rotation = rotation_by(turn)
        move_particles(particles, np.arange(particles.means.shape[1]), move, turn)
        particles.gnss_bias = rotation @ particles.gnss_bias
        self._hindsight.move(move, turn)
        table = self._table
        table.xy[:] = move(table.xy)
        cos, sin = rotation[:, 0]
        table.covariance[:] = turned(cos, -sin, table.covariance.T).T
        move_sightings(table, np.arange(len(table)), move, turn)
        self.frame = new
        self._centre = None
        return True
