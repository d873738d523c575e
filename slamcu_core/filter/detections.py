"""A frame: when and where it was taken, and its detections as arrays, of which all is asked at once."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Detection
from slamcu_core.evidence import support_of
from slamcu_core.filter.table import Vocabulary
from slamcu_core.models import SensorModel

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Instant:
    """When and where a frame was taken."""

    t: float  # s since the start of the drive
    share: float  # of the frame's evidence that is its own
    fresh: float  # of what it measures that is its own
    pose: Array  # (3,) mean of the particles
    reckoned: Array  # (3,) pose by dead reckoning: it drifts, but never jumps
    speed: float  # m/s


@dataclass(frozen=True, slots=True)
class Seen:
    """The detections of a frame as arrays: D measurements with variances and codes."""

    measurement: Array  # (2, D)
    noise: Array  # (2, D)
    ahead_left: Array  # (2, D) m, where they are as seen from the vehicle
    toward: Array  # (2, D) the direction of the measurement's first axis there
    feature_class: Index
    sign: Index
    value: Index
    weight: Array  # of eq. 1

    @property
    def named(self) -> bool:
        """Whether the sign or value of any was read."""
        return bool(self.sign.any() or self.value.any())

    def keep(self, which: NDArray[np.bool_]) -> Seen:
        """Return only some of the detections, (D,)."""
        if which.all():
            return self
        index = which.nonzero()[0]
        return Seen(*(getattr(self, name).take(index, axis=-1) for name in _ARRAYS))


_ARRAYS = tuple(item.name for item in fields(Seen))


def read_detections(model: SensorModel, items: tuple[Detection, ...], names: Vocabulary) -> Seen:
    """Turn detections into arrays; raises SlamcuError if one lacks what its sensor measures."""
    measurement = np.array([model.measurement(item) for item in items], float).reshape(-1, 2).T
    feature_class = np.array([names.code(item.feature_class) for item in items], dtype=np.intp)
    sign = value = np.zeros(len(items), dtype=np.intp)
    if any(item.sign is not None or item.value is not None for item in items):
        sign = np.array([names.code(item.sign) for item in items], dtype=np.intp)
        value = np.array([names.code(item.value) for item in items], dtype=np.intp)
    weight = np.array([support_of(item.confidence) for item in items])
    return Seen(
        measurement, model.noise(measurement), *model.in_vehicle(measurement), feature_class, sign, value, weight
    )
