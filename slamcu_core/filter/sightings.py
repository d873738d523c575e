"""What a sighting leaves behind in the feature table: for the report of the pass, and for the proof of standing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter import standing
from slamcu_core.filter.detections import Instant, Seen
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_LEAST = 1e-12  # variance; a sensor may claim to measure the range 0 without error


class SightingNotes:
    """Notes the sightings of rows, and what finds were read as."""

    def __init__(self, table: FeatureTable) -> None:
        self._table = table
        self._votes: dict[int, tuple[int, Counter[tuple[int, int]]]] = {}  # by row, with the number of the find

    def add(
        self,
        model: SensorModel,
        rows: Index,
        seen: Seen,
        detections: Index,
        *,
        now: Instant,
        beyond: tuple[float, float],
    ) -> None:
        """Note where rows were seen, for their reports and for whether they stand still.

        The sums are as the vehicle's first sensor would have them: `beyond` it this one stretches and turns by so much.
        """
        table = self._table
        seen_from = np.concatenate([seen.ahead_left, seen.toward, seen.measurement[:1], seen.noise])
        sightings = seen_from.take(detections, axis=1).T.tolist()
        table.sighted[rows] += _sums(model, now.pose.tolist(), sightings, beyond)
        own = (table.kind[rows] == Kind.NEW).nonzero()[0]
        if not len(own):
            return
        rows = rows[own]
        # whether finds stand still, by dead reckoning, for a correction of the pose would look like motion
        by_reckoning = _placed(now.reckoned.tolist(), [sightings[index] for index in own.tolist()])
        standing.track(table, rows, model, by_reckoning, now.t)
        self._vote(rows, seen, detections[own])

    def _vote(self, rows: Index, seen: Seen, detections: Index) -> None:
        """Let detections that were read say what sign finds are."""
        if not seen.named:
            return
        for index in ((seen.sign[detections] > 0) | (seen.value[detections] > 0)).nonzero()[0].tolist():
            row, detection = int(rows[index]), detections[index]
            number = int(self._table.number[row])
            if row not in self._votes or self._votes[row][0] != number:  # or the row was of a find that was left behind
                self._votes[row] = number, Counter()
            votes = self._votes[row][1]
            votes[int(seen.sign[detection]), int(seen.value[detection])] += 1
            self._table.sign[row], self._table.value[row] = votes.most_common(1)[0][0]

    def forget(self, row: int) -> None:
        """Forget what a find was read as."""
        self._votes.pop(row, None)


def _placed(pose: Sequence[float], sightings: Sequence[Sequence[float]]) -> Iterator[tuple[float, ...]]:
    """Yield sightings from a vehicle's pose with their place and direction turned into its frame.

    Of each sighting: its place, its direction, and the first component of what was measured and the variances of both.
    A handful of them is sooner done in plain numbers than as arrays.
    """
    x, y, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    for ahead, left, along, aside, distance, first, second in sightings:
        place = x + cos * ahead - sin * left, y + sin * ahead + cos * left
        toward = cos * along - sin * aside, sin * along + cos * aside
        yield *place, *toward, distance, max(first, _LEAST), max(second, _LEAST)


def _sums(
    model: SensorModel, pose: Sequence[float], sightings: Sequence[Sequence[float]], beyond: tuple[float, float]
) -> list[tuple[float, ...]]:
    """Return what sightings from a pose add to the parts of `sighted`, each (13,), in their order."""
    sums: list[tuple[float, ...]] = []
    (here_x, here_y, _), (scale, turn) = pose, beyond
    for x, y, cos, sin, distance, first, second in _placed(pose, sightings):
        xx, xy, yy = model.information(cos, sin, distance, first, second)
        weight, across = 1.0 / first, 1.0 / (max(distance, 1e-3) * second)
        stretch = weight * distance
        by_error = stretch * cos, stretch * sin, -(across * sin), across * cos
        east = xx * x + xy * y - scale * by_error[0] - turn * by_error[2]
        north = xy * x + yy * y - scale * by_error[1] - turn * by_error[3]
        sums.append((xx, xy, xy, yy, east, north, weight, weight * here_x, weight * here_y, *by_error))
    return sums
