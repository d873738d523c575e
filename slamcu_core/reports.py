"""What a car tells the cloud: the evidence of its passes, in messages that are taken or refused whole."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from slamcu_core.hd_map import MapIdentity


class DetectionStatus(StrEnum):
    """SENSORIS EventDetectionStatus.Type: what was expected and what was found."""

    EXPECTED_AND_DETECTED = "EXPECTED_AND_DETECTED"
    EXPECTED_AND_NOT_DETECTED = "EXPECTED_AND_NOT_DETECTED"
    EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED = "EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED"
    EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE = "EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE"
    NOT_EXPECTED_AND_DETECTED = "NOT_EXPECTED_AND_DETECTED"


@dataclass(frozen=True, slots=True)
class MapReference:
    """Which feature of the map (or which watch feature, if tile_id < 0) a report is about."""

    tile_id: int
    object_id: int

    @property
    def watched(self) -> bool:
        """Whether this refers to a watch feature."""
        return self.tile_id < 0


@dataclass(frozen=True, slots=True)
class MeasuredPosition:
    """A place with its covariance, the pose's uncertainty included."""

    lon: float  # degrees
    lat: float  # degrees
    covariance_m2: tuple[float, float, float]  # xx, xy, yy in east-north


@dataclass(frozen=True, slots=True)
class PassReport:
    """The evidence of one pass: one continuous stay of a feature in a sensor's view, without the map's prior.

    A report of a car's own unmapped find that it looked for again and missed has no reference, status
    EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE and a position: evidence against a candidate there.
    """

    started_at: datetime  # aware, microseconds
    ended_at: datetime
    status: DetectionStatus
    weight_for: float  # f >= 0 over the frames of the pass
    weight_against: float  # a >= 0
    feature_class: str = "traffic_sign"
    sign: str | None = None  # as seen (or as mapped, if not seen)
    value: str | None = None
    reference: MapReference | None = None
    position: MeasuredPosition | None = None  # where it was seen; None if it was not seen
    frames_detected: int = 0
    frames_missed: int = 0
    frames_blocked: int = 0
    valid: bool = True  # False: seen, but crossed out or covered as a whole; not a deletion


class Doubt(StrEnum):
    """Why a filter is not to be trusted."""

    MAP = "map"  # it explains too little of what is seen and missed
    FIXES = "fixes"  # satellite fixes contradict the pose, or did until just now
    ODOMETRY = "odometry"  # was silent, and neither map nor fixes have said since where the car is
    NUMBERS = "numbers"  # have broken down


@dataclass(frozen=True, slots=True)
class Health:
    """How far the filter that made a report is to be trusted."""

    trusted: bool = True
    effective_particles: float = 1.0  # M_eff / M, in (0, 1]
    innovation_ratio: float = 1.0  # mean normalised innovation squared over its expectation
    unexplained_ratio: float = 0.0  # detections that nothing explained, over all
    doubt: Doubt | None = None  # why it is not trusted; known on board only


@dataclass(frozen=True, slots=True)
class ReportMessage:
    """One SENSORIS DataMessage: passes of one session over one map version, under one id."""

    session_id: str
    message_id: int  # from 1, rising within a session
    passes: tuple[PassReport, ...] = ()
    last_of_session: bool = False
    vehicle_id: str = ""  # a rotating pseudonym; never an identity
    fleet_id: str = ""
    map_identity: MapIdentity = field(default_factory=MapIdentity)
    sensor_model: str = ""
    software_version: str = ""
    health: Health = field(default_factory=Health)
