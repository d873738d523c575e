"""What a receiver takes, and what it assumes where a sender says nothing."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from slamcu_core.errors import FieldError, check_whole, check_within

MAX_PASS_WEIGHT = 1000.0
"""The most that f or a of one pass may weigh: exp(-1000) of doubt is none, whatever the law does with it."""


@dataclass(frozen=True, slots=True)
class WireLimits:
    """Bounds on what one message may hold; beyond them it is refused."""

    max_messages: int = 1000  # per batch
    max_events: int = 2000  # per message, map references included
    max_text: int = 200  # characters of an id, name or value
    max_frames: int = 10_000_000  # per count of a pass
    max_pass_weight: float = MAX_PASS_WEIGHT
    max_position_std_m: float = 100.0  # along the longer axis: a place vaguer than that is none
    max_offset_m: float = 10_000.0  # of a metric position from its origin
    altitude_m: tuple[float, float] = (
        -1000.0,
        10_000.0,
    )  # roads from the Dead Sea to the passes of the Andes, generously
    earliest: datetime = datetime(2000, 1, 1, tzinfo=UTC)
    latest: datetime = datetime(2100, 1, 1, tzinfo=UTC)  # a receiver with a clock sets this to soon after its now

    def __post_init__(self) -> None:
        """Raise FieldError, naming the field, for bounds that would let through what cannot be stored."""
        for name in ("max_messages", "max_events", "max_text", "max_frames"):
            check_whole(self, name, 1, 2**31 - 1)
        check_within(self, "max_pass_weight", 0.0, MAX_PASS_WEIGHT, "")
        check_within(self, "max_position_std_m", 0.0, 1e5, "m")
        check_within(self, "max_offset_m", 0.0, 1e6, "m")
        low, high = self.altitude_m
        if not -1e5 <= low <= high <= 1e5:
            raise FieldError("altitude_m", "two ascending numbers in [-100000, 100000] m", self.altitude_m)
        for name in ("earliest", "latest"):
            if getattr(self, name).tzinfo is None:
                raise FieldError(name, "an instant with a time zone", getattr(self, name))
        if self.latest < self.earliest:
            raise FieldError("latest", f"not before earliest, {self.earliest}", self.latest)


@dataclass(frozen=True, slots=True)
class ThirdPartyDefaults:
    """What a message without our extension is worth where it leaves confidence or accuracy out.

    Low on purpose: a sender that states nothing must not outweigh those that do. Our choice; SENSORIS has no defaults.
    """

    detected: float = 0.3  # λ of eq. 1 without existence_confidence
    not_detected: float = 0.3  # λ of eq. 2 without a confidence of the status
    unexplained_discount: float = 0.5  # times λ, where it is not said whether the view was free
    position_std_m: float = 5.0  # each axis

    def __post_init__(self) -> None:
        """Raise FieldError, naming the field, for what is no confidence and no accuracy."""
        for name in ("detected", "not_detected", "unexplained_discount"):
            check_within(self, name, 0.0, 1.0, "")
        check_within(self, "position_std_m", 1e-3, 1e5, "m")


DEFAULT_LIMITS = WireLimits()
DEFAULT_THIRD_PARTY = ThirdPartyDefaults()
