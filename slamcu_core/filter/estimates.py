"""What the filter tells: the pose, and each feature with its class, masses and place."""

from __future__ import annotations

from dataclasses import dataclass

from slamcu_core.evidence import Masses
from slamcu_core.hd_map import MapFeature


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """The vehicle's pose: weighted mean of the particles with its covariance."""

    t: float  # s since the start of the drive
    lon: float  # degrees
    lat: float  # degrees
    heading_deg: float  # compass
    covariance_m2: tuple[float, float, float]  # xx, xy, yy in east-north
    heading_std_deg: float


@dataclass(frozen=True, slots=True)
class FeatureEstimate:
    """What the car believes about one feature."""

    feature: MapFeature | None  # of the map or on watch; None: found by this car
    state: str  # normal, deleted, new or unclassified (section 4.3.3); of a session also modified or moved
    masses: Masses  # with the map's prior
    conflict: float
    lon: float  # degrees
    lat: float
    covariance_m2: tuple[float, float, float]  # xx, xy, yy in east-north
    passes: int
    feature_class: str
    sign: str | None
    value: str | None
