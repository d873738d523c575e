"""The HD map as the filter holds it: arrays over features, found by tile."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.errors import FieldError, FormatError, check_within
from slamcu_core.geometry import Cell, cell_of, cells_within

_CELL_DEG = 0.002  # about 220 m north-south: a few cells cover any sensor's reach


@dataclass(frozen=True, slots=True)
class MapFeature:
    """A point feature of an HD map, or a watch feature: a candidate that vehicles check but never localize on.

    `tile_id` and `object_id` are what a report's MAP_REFERENCE carries. Map features have their map's positive object
    id; watch features have an id space of their own, told by a negative tile id.
    """

    object_id: int
    lon: float  # degrees
    lat: float  # degrees
    feature_class: str = "traffic_sign"
    sign: str | None = None  # SENSORIS TrafficSign type name
    value: str | None = None
    altitude: float | None = None  # m above the WGS84 ellipsoid
    heading_deg: float | None = None  # compass direction that the face looks
    existence_confidence: float = 0.95  # λ_HD of eq. 3
    position_std_m: float = 0.15  # each axis
    tile_id: int = 0
    moved_from: int | None = None  # of a watch feature: the object id of what would have moved to there

    def __post_init__(self) -> None:
        """Raise FieldError for a place or a confidence that makes no sense."""
        if not (math.isfinite(self.lon) and -90.0 <= self.lat <= 90.0):
            raise FieldError("lon, lat", "finite degrees, lat in [-90, 90]", (self.lon, self.lat))
        check_within(self, "existence_confidence", 0.0, 1.0, "")
        check_within(self, "position_std_m", 0.0, 1e3, "m")

    @property
    def watched(self) -> bool:
        """Whether this is a watch feature (no prior, not for localization)."""
        return self.tile_id < 0


@dataclass(frozen=True, slots=True)
class MapIdentity:
    """Which map a vehicle compared with: its source (the map's name) and version."""

    source: str = ""
    version: str = ""


class HDMap:
    """The features of one map version with an index by place.

    Parameters
    ----------
    features : the features; iterated once.
    identity : source and version of the map.

    Raises FormatError if two features share a reference (tile sign and object id).
    """

    def __init__(self, features: Iterable[MapFeature], identity: MapIdentity | None = None) -> None:
        self.identity = identity or MapIdentity()
        self.features: Sequence[MapFeature] = tuple(features)
        seen: set[tuple[bool, int]] = set()
        for feature in self.features:
            key = (feature.watched, feature.object_id)
            if key in seen:
                raise FormatError(f"two features have the id {feature.object_id}", field="id")
            seen.add(key)
        self._disputed = frozenset(f.moved_from for f in self.features if f.watched and f.moved_from is not None)
        self.lonlat: NDArray[np.float64] = np.array([(f.lon, f.lat) for f in self.features], float).reshape(-1, 2)
        self._cells: dict[Cell, list[int]] = {}
        for index, feature in enumerate(self.features):
            self._cells.setdefault(cell_of(feature.lon, feature.lat, _CELL_DEG), []).append(index)

    def __len__(self) -> int:
        return len(self.features)

    def __iter__(self) -> Iterator[MapFeature]:
        return iter(self.features)

    def is_disputed(self, feature: MapFeature) -> bool:
        """Whether a feature of the map is believed to have moved: then vehicles do not localize on it."""
        return not feature.watched and feature.object_id in self._disputed

    def prior(self, feature: MapFeature) -> float:
        """Return λ_HD of a feature (eq. 3): 0 for a watch feature, and for what a watch feature says has moved."""
        return 0.0 if feature.watched or self.is_disputed(feature) else feature.existence_confidence

    def near(self, lon: float, lat: float, radius_m: float) -> NDArray[np.intp]:
        """Return the indices of the features in cells within `radius_m` of a place (a superset, sorted)."""
        cells = cells_within(float(lon), float(lat), radius_m, _CELL_DEG)
        hits = [index for cell in cells for index in self._cells.get(cell, ())]
        return np.array(sorted(hits), dtype=np.intp)
