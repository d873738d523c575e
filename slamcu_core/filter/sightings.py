"""What a sighting leaves behind in the feature table: for the report of the pass, and for the proof of standing."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import standing
from slamcu_core.filter.detections import Instant, Seen
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.geometry import rotation
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_LEAST = 1e-12  # variance; a sensor may claim to measure the range 0 without error


class SightingNotes:
    """Notes the sightings of rows, and what finds were read as."""

    def __init__(self, table: FeatureTable) -> None:
        self._table = table
        self._votes: dict[int, Counter[tuple[int, int]]] = {}

    def add(self, model: SensorModel, rows: Index, seen: Seen, detections: Index, now: Instant) -> None:
        """Note where rows were seen, for their reports and for whether they stand still."""
        table = self._table
        measured = seen.measurement.take(detections, axis=1)
        noise = np.maximum(seen.noise.take(detections, axis=1), _LEAST)
        ahead_left, ahead = seen.ahead_left.take(detections, axis=1), seen.toward.take(detections, axis=1)
        here, heading = now.pose[:2], rotation(float(now.pose[2]))
        places, toward = heading @ ahead_left + here[:, None], heading @ ahead
        table.sighted[rows] += _sums(model, here, np.concatenate([places, toward, measured, noise]))
        own = (table.kind[rows] == Kind.NEW).nonzero()[0]
        if not len(own):
            return
        rows = rows[own]
        # whether finds stand still, by dead reckoning, for a correction of the pose would look like motion
        heading = rotation(float(now.reckoned[2]))
        places, toward = heading @ ahead_left.take(own, axis=1), heading @ ahead.take(own, axis=1)
        places += now.reckoned[:2, None]
        sightings = np.concatenate([places, toward, measured.take(own, axis=1), noise.take(own, axis=1)])
        standing.track(table, rows, model, sightings, now.t)
        self._vote(rows, seen, detections[own])

    def _vote(self, rows: Index, seen: Seen, detections: Index) -> None:
        """Let detections that were read say what sign finds are."""
        if not seen.named:
            return
        for index in ((seen.sign[detections] > 0) | (seen.value[detections] > 0)).nonzero()[0].tolist():
            row, detection = int(rows[index]), detections[index]
            votes = self._votes.setdefault(row, Counter())
            votes[int(seen.sign[detection]), int(seen.value[detection])] += 1
            self._table.sign[row], self._table.value[row] = votes.most_common(1)[0][0]

    def forget(self, row: int) -> None:
        """Forget what a find was read as."""
        self._votes.pop(row, None)


def _sums(model: SensorModel, here: Array, sightings: Array) -> list[list[float]]:
    """Return what sightings (8, A) from a place (2,) add to the parts of `sighted`, each (13,), in their order.

    Of each sighting: its place, its direction, and the two components of what was measured and of the variances. A
    handful of them is sooner done in plain numbers than as arrays.
    """
    sums, (here_x, here_y) = [], here.tolist()
    for x, y, cos, sin, distance, _, *noise in sightings.T.tolist():
        xx, xy, yy = model.information(cos, sin, distance, *noise)
        weight, across = 1.0 / noise[0], 1.0 / (max(distance, 1e-3) * noise[1])
        stretch = weight * distance
        position = xx, xy, xy, yy, xx * x + xy * y, xy * x + yy * y
        view = weight, weight * here_x, weight * here_y
        sums.append([*position, *view, stretch * cos, stretch * sin, -(across * sin), across * cos])
    return sums
