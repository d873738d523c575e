"""What can be set about the filter, with units and where each number comes from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from slamcu_core.errors import FieldError, check_whole, check_within
from slamcu_core.models import MotionNoise


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """Settings of the SLAMCU filter; the defaults suit a car with a series camera."""

    particles: int = 100  # M of eq. 11
    motion: MotionNoise = field(default_factory=MotionNoise)
    miss_confidence: float = 0.9  # λ of eq. 2, before P(visible) and P_D (errata)
    gate: float = 13.8  # chi-square with 2 degrees of freedom at 99.9 %, on the innovation (section 4.3.1)
    resample_fraction: float = 0.5  # α of eq. 20
    jitter: float = 0.6  # kernel width of regularised resampling, in standard deviations of the cloud: Silverman's rule
    outlier_share: float = 0.02  # share of accepted associations that are wrong: floors eq. 17 and 18
    unmapped_share: float = 0.2  # things that the map lacks, per feature that it has, before anybody looked
    detection_concentration: float = 4.0  # looks; weight of the sensor's nominal P_D within one pass
    correlation_time_s: float = 0.3  # frames closer than this share their errors and are tempered (errata to 6.2)
    evidence_cap: float = 15.0  # largest weight kept per feature on board, so that a drive can still change its mind
    range_scale_std: float = 0.02  # of the range, constant per vehicle; learned from the map's features
    bearing_bias_std: float = 0.003  # rad, constant per vehicle; learned likewise
    calibration_time_s: float = 600.0  # s; time in which those two may change
    pass_range_std: float = 0.015  # of the range, constant within one pass; nothing on board can learn it
    pass_bearing_std: float = 0.001  # rad, likewise
    gnss_white_share: float = 0.4  # of a fix's std_m; the rest is a bias that wanders slowly
    gnss_correlation_s: float = 180.0  # time constant of that bias
    pass_gap_s: float = 5.0  # a feature out of view this long has left it (design: definition of a pass)
    max_new: int = 64  # live unmapped features; beyond, no more are begun until one is left behind or refuted
    kept_finds: int = 2_000  # finds left behind that are remembered; beyond, the oldest give way
    minimum_hits: int = 3  # detections before an unmapped feature may be called New
    mover_speed: float = 1.0  # m/s; what moves at all moves at least so fast

    @classmethod
    def robot(cls, **changes: Any) -> FilterParameters:
        """Return settings for a small indoor robot: coarse odometry, hence wider gates and more wrong associations."""
        return cls(**{"motion": MotionNoise.robot(), "gate": 20.0, "outlier_share": 0.1, **changes})

    def __post_init__(self) -> None:
        """Raise FieldError, naming the field, for a value with which the filter's equations mean nothing."""
        if not isinstance(self.motion, MotionNoise):
            raise FieldError("motion", "a MotionNoise", self.motion)
        for name, least, most in _COUNTS:
            check_whole(self, name, least, most)
        for name, low, high, unit in _RANGES:
            check_within(self, name, low, high, unit)


_COUNTS = (
    ("particles", 2, 100_000),
    ("max_new", 1, 10_000),
    ("kept_finds", 1, 1_000_000),
    ("minimum_hits", 1, 1_000),
)
_RANGES = (
    ("miss_confidence", 0.0, 1.0, ""),
    ("gate", 1.0, 100.0, ""),
    ("resample_fraction", 0.0, 1.0, "of the particles"),
    ("jitter", 0.0, 1.0, "standard deviations"),
    ("outlier_share", 0.0, 0.5, ""),
    ("unmapped_share", 0.0, 100.0, "per feature"),
    ("detection_concentration", 1e-3, 1e12, "looks"),
    ("correlation_time_s", 0.0, 3_600.0, "s"),
    ("evidence_cap", 1.0, 500.0, ""),  # its exponential is a number
    ("range_scale_std", 0.0, 1.0, "of the range"),
    ("bearing_bias_std", 0.0, 3.0, "rad"),
    ("calibration_time_s", 1e-3, 1e9, "s"),
    ("pass_range_std", 0.0, 1.0, "of the range"),
    ("pass_bearing_std", 0.0, 3.0, "rad"),
    ("gnss_white_share", 0.01, 1.0, "of std_m"),  # without white noise one fix would say all
    ("gnss_correlation_s", 0.0, 1e9, "s"),
    ("pass_gap_s", 0.0, 3_600.0, "s"),
    ("mover_speed", 0.0, 150.0, "m/s"),
)
