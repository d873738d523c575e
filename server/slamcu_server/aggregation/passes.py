"""A pass as the server keeps it: what a contributor reported, and what it counts for."""

from __future__ import annotations

from datetime import datetime
from typing import NamedTuple

from slamcu_core.aggregation import PassEvidence
from slamcu_core.reports import DetectionStatus

# tuples: a member is found in them by its identity, in a set by the slow hash of an enumeration
FOUND_STATUSES = (DetectionStatus.EXPECTED_AND_DETECTED, DetectionStatus.NOT_EXPECTED_AND_DETECTED)
BLOCKED_STATUS = DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED
_OWN_FIND_MISSED = (
    DetectionStatus.EXPECTED_AND_NOT_DETECTED,
    DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE,
)

PassKey = tuple[int, str, int, int]
"""What a pass is whatever order it came in: contributor, session, message id, index in the message."""

MeasuredPlace = tuple[float, float, tuple[float, float, float]]
"""Longitude and latitude (degrees), and the covariance in m²: xx, xy, yy in east-north."""


class StoredPass(NamedTuple):
    """One stored pass; a tuple, because a fold reads thousands of them."""

    id: int
    key: PassKey
    map_id: int
    started_at: datetime
    ended_at: datetime
    status: DetectionStatus
    feature_class: str
    sign: str | None
    value: str | None
    weight_for: float
    weight_against: float
    valid: bool
    trusted: bool
    feature_id: int | None = None  # the map feature it counts for
    watch_id: int | None = None  # the watch feature it named
    candidate_id: int | None = None  # the candidate it counts for
    place: MeasuredPlace | None = None  # if it has one
    archived: bool = False  # kept to be explained, and not folded

    @property
    def contributor(self) -> int:
        """The account that reported it."""
        return self.key[0]

    @property
    def order(self) -> tuple[datetime, PassKey]:
        """The canonical order of passes: event time, then identity."""
        return self.ended_at, self.key

    @property
    def counts(self) -> bool:
        """Whether it is evidence by itself: from a filter to be trusted, about something that was not crossed out.

        What was said in doubt is evidence only together with what others say; the law decides that.
        """
        return self.trusted and self.valid

    @property
    def blocked(self) -> bool:
        """Whether something stood between the sensor and the place."""
        return self.status is BLOCKED_STATUS

    @property
    def found(self) -> bool:
        """Whether the feature was seen, crossed out or not."""
        return self.status in FOUND_STATUSES

    @property
    def clusters(self) -> bool:
        """Whether its place makes it part of a candidate: an unmapped find, or such a find looked for and missed."""
        if not self.valid or self.place is None or self.feature_id is not None or self.watch_id is not None:
            return False
        return self.status is DetectionStatus.NOT_EXPECTED_AND_DETECTED or self.status in _OWN_FIND_MISSED

    @property
    def weights(self) -> tuple[float, float]:
        """Its weights for and against; none if it was crossed out or blocked (occlusion is vacuous, eq. 4)."""
        speaks = self.valid and not self.blocked
        return (self.weight_for, self.weight_against) if speaks else (0.0, 0.0)

    @property
    def evidence(self) -> PassEvidence:
        """What the law folds of it."""
        return PassEvidence(self.contributor, self.ended_at.timestamp(), *self.weights, doubtful=not self.trusted)
