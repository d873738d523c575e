"""A frame: when and where it was taken, and its detections as arrays, of which all is asked at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Detection
from slamcu_core.evidence import support_of
from slamcu_core.filter.table import Vocabulary
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class Instant(NamedTuple):
    """When and where a frame was taken."""

    t: float  # s since the start of the drive
    share: float  # of the frame's evidence that is its own
    fresh: float  # of what it measures that is its own
    pose: Array  # (3,) mean of the particles
    reckoned: Array  # (3,) pose by dead reckoning: it drifts, but never jumps
    speed: float  # m/s


class Seen(NamedTuple):
    """The detections of a frame as arrays: D measurements with variances and codes."""

    measurement: Array  # (2, D)
    noise: Array  # (2, D)
    ahead_left: Array  # (2, D) m, where they are as seen from the vehicle
    toward: Array  # (2, D) the direction of the measurement's first axis there
    feature_class: Index
    sign: Index
    value: Index
    weight: Array  # of eq. 1
    named: bool  # whether the sign or value of any may have been read

    def believed(self, certain: Array) -> Seen:
        """Return the detections as evidence of what they are taken for, which each is with a probability (D,)."""
        return self._replace(weight=-np.log1p(np.expm1(-self.weight) * certain))

    def without(self, which: NDArray[np.bool_]) -> Seen:
        """Return the detections but for some, (D,)."""
        if not np.count_nonzero(which):
            return self
        index = (~which).nonzero()[0]
        *arrays, named = self
        return Seen._make((*(array.take(index, axis=-1) for array in arrays), named))


def read_detections(model: SensorModel, items: tuple[Detection, ...], names: Vocabulary) -> Seen:
    """Turn detections into arrays; raises SlamcuError if one lacks what its sensor measures."""
    measurement = model.measurements(items)
    feature_class = names.codes([item.feature_class for item in items])
    sign = value = np.zeros(len(items), dtype=np.intp)
    signs, values = [item.sign for item in items], [item.value for item in items]
    named = signs.count(None) < len(items) or values.count(None) < len(items)
    if named:
        sign, value = names.codes(signs), names.codes(values)
    weight = np.array([support_of(item.confidence) for item in items])
    noise, (ahead_left, toward) = model.noise(measurement), model.in_vehicle(measurement)
    return Seen(measurement, noise, ahead_left, toward, feature_class, sign, value, weight, named)
