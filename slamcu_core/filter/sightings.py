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

Index = NDArray[np.intp]


class SightingNotes:
    """Notes the sightings of rows, and what finds were read as."""

    def __init__(self, table: FeatureTable) -> None:
        self._table = table
        self._votes: dict[int, Counter[tuple[int, int]]] = {}

    def add(self, model: SensorModel, rows: Index, seen: Seen, detections: Index, now: Instant) -> None:
        """Note where rows were seen, for their reports and for whether they stand still."""
        table = self._table
        here, heading = now.pose[:2], rotation(float(now.pose[2]))
        measured, noise = seen.measurement.take(detections, axis=1), seen.noise.take(detections, axis=1)
        ahead_left, ahead = seen.ahead_left.take(detections, axis=1), seen.toward.take(detections, axis=1)
        x, y = heading @ ahead_left + here[:, None]
        toward = heading @ ahead
        xx, xy, yy = model.information(toward, measured, noise)
        weight = 1.0 / noise[0]
        across = 1.0 / (np.maximum(measured[0], 1e-3) * noise[1])
        sums = np.empty((13, len(rows)))  # in the order of the parts of `sighted`
        sums[0], sums[1], sums[2], sums[3] = xx, xy, xy, yy
        np.add(xx * x, xy * y, out=sums[4])
        np.add(xy * x, yy * y, out=sums[5])
        sums[6] = weight
        np.multiply(weight, here[:, None], out=sums[7:9])
        np.multiply(weight * measured[0], toward, out=sums[9:11])
        np.multiply(across, toward[::-1], out=sums[11:])
        np.negative(sums[11], out=sums[11])
        table.sighted[rows] += sums.T
        own = (table.kind[rows] == Kind.NEW).nonzero()[0]
        if not len(own):
            return
        rows = rows[own]
        # whether finds stand still, by dead reckoning, for a correction of the pose would look like motion
        heading = rotation(float(now.reckoned[2]))
        places = heading @ ahead_left.take(own, axis=1) + now.reckoned[:2, None]
        axis = table.axis.take(rows, axis=0).T
        across = standing.along_road(axis, heading @ ahead.take(own, axis=1))
        information = model.information(across, measured.take(own, axis=1), noise.take(own, axis=1))
        offset = standing.along_road(axis, places - table.origin.take(rows, axis=0).T)
        standing.track(table, rows, offset, information, now.t)
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
