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
        measured, noise = seen.measurement[:, detections], seen.noise[:, detections]
        ahead_left = seen.ahead_left[:, detections]
        x, y = heading @ ahead_left + here[:, None]
        toward = heading @ seen.toward[:, detections]
        xx, xy, yy = model.information(toward, measured, noise)
        weight = 1.0 / noise[0]
        across = 1.0 / (np.maximum(measured[0], 1e-3) * noise[1])
        sums = np.empty((13, len(rows)))  # in the order of the parts of `sighted`
        sums[0], sums[1], sums[2], sums[3] = xx, xy, xy, yy
        sums[4], sums[5] = xx * x + xy * y, xy * x + yy * y
        sums[6] = weight
        np.multiply(weight, here[:, None], out=sums[7:9])
        np.multiply(weight * measured[0], toward, out=sums[9:11])
        np.multiply(across, toward[::-1], out=sums[11:])
        np.negative(sums[11], out=sums[11])
        table.sighted[rows] += sums.T
        own = (table.kind[rows] == Kind.NEW).nonzero()[0]
        if len(own):
            self._track(model, rows[own], seen, detections[own], now)
            self._vote(rows[own], seen, detections[own])

    def _track(self, model: SensorModel, rows: Index, seen: Seen, detections: Index, now: Instant) -> None:
        """Note sightings (A,) of finds for whether they stand still."""
        # by dead reckoning, for a correction of the pose would look like motion
        heading = rotation(float(now.reckoned[2]))
        places = heading @ seen.ahead_left[:, detections] + now.reckoned[:2, None]
        across = standing.road(self._table, rows, heading @ seen.toward[:, detections])
        information = model.information(across, seen.measurement[:, detections], seen.noise[:, detections])
        standing.track(self._table, rows, places, information, now.t)

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
