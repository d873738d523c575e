"""What a receiver takes, and what it assumes where a sender says nothing."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

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


@dataclass(frozen=True, slots=True)
class ThirdPartyDefaults:
    """What a message without our extension is worth where it leaves confidence or accuracy out.

    Low on purpose: a sender that states nothing must not outweigh those that do. Our choice; SENSORIS has no defaults.
    """

    detected: float = 0.3  # λ of eq. 1 without existence_confidence
    not_detected: float = 0.3  # λ of eq. 2 without a confidence of the status
    unexplained_discount: float = 0.5  # times λ, where it is not said whether the view was free
    position_std_m: float = 5.0  # each axis


DEFAULT_LIMITS = WireLimits()
DEFAULT_THIRD_PARTY = ThirdPartyDefaults()
