"""What the change API takes and answers."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator
from pydantic.config import JsonDict

from slamcu_server.changes.belief import Because, Kind, State
from slamcu_server.maps.schemas import Point

_CHANGE_EXAMPLE: JsonDict = {
    "id": 12,
    "kind": "new",
    "state": "confirmed",
    "revision": 2,
    "map": "demo",
    "map_object_id": None,
    "watch_id": 5,
    "class": "traffic_sign",
    "sign": "SPEED_LIMIT",
    "value": "80",
    "geometry": {"type": "Point", "coordinates": [2.10031, 48.90012]},
    "covariance_m2": [0.11, 0.01, 0.09],
    "ellipse95": {"semi_major_m": 0.83, "semi_minor_m": 0.72, "orientation_deg": 67.5},
    "mass_exists": 0.94,
    "mass_not_exists": 0.0,
    "mass_unknown": 0.06,
    "conflict": 0.0,
    "weight_for": 2.8,
    "weight_against": 0.0,
    "contributors_for": 3,
    "contributors_against": 0,
    "passes": 4,
    "first_seen": "2026-05-01T08:12:40+00:00",
    "last_seen": "2026-05-02T07:55:03+00:00",
    "last_looked": "2026-05-02T07:55:03+00:00",
    "confirmed_at": "2026-05-01T11:40:21+00:00",
    "policy_version": "3f1c92ab04de",
    "trust_version": 17,
    "first_evidence": "2026-05-01T08:12:40+00:00",
    "from": None,
    "to": None,
    "merged_into": None,
    "joined_into": None,
    "withdrawn_because": None,
    "mapped_at": None,
    "mapped_in": None,
    "review": None,
}

_OLD: JsonDict = {
    "class": "traffic_sign",
    "sign": "SPEED_LIMIT",
    "value": "80",
    "geometry": {"type": "Point", "coordinates": [2.10027, 48.90012]},
    "covariance_m2": [0.0225, 0.0, 0.0225],
    "ellipse95": {"semi_major_m": 0.37, "semi_minor_m": 0.37, "orientation_deg": 0.0},
    "mass_exists": 0.0,
    "mass_not_exists": 0.9,
    "mass_unknown": 0.1,
    "conflict": 0.0,
    "weight_for": 0.0,
    "weight_against": 2.3,
    "contributors_for": 0,
    "contributors_against": 4,
    "passes": 5,
    "last_seen": "2026-04-28T17:02:10+00:00",
    "last_looked": "2026-05-02T07:55:03+00:00",
}
_NEW_HALF: JsonDict = {
    **{name: _CHANGE_EXAMPLE[name] for name in _OLD},
    "geometry": {"type": "Point", "coordinates": [2.10031, 48.90012]},
}
_MOVED_EXAMPLE: JsonDict = {
    **_CHANGE_EXAMPLE,
    "id": 13,
    "kind": "moved",
    "revision": 4,
    "map_object_id": 17,
    "passes": 9,
    "from": _OLD,
    "to": _NEW_HALF,
}


class Ellipse(BaseModel):
    """The 95 % ellipse of a place."""

    semi_major_m: float
    semi_minor_m: float
    orientation_deg: float = Field(description="Compass direction of the longer axis, in [0, 180).")


class Evidence(BaseModel):
    """Weights of evidence, the masses on {exists, not} that they stand for, and the conflict between them."""

    weight_for: float
    weight_against: float
    mass_exists: float
    mass_not_exists: float
    mass_unknown: float
    conflict: float = Field(description="1 - exp(-weight_for) times 1 - exp(-weight_against): dispute, not ignorance.")


class Half(Evidence):
    """One end of a moved or modified feature: what the map says, or what is there now."""

    feature_class: str = Field(alias="class")
    sign: str | None
    value: str | None
    geometry: Point
    covariance_m2: tuple[float, float, float] = Field(description="xx, xy, yy in east-north.")
    ellipse95: Ellipse
    contributors_for: int
    contributors_against: int
    passes: int
    last_seen: datetime | None
    last_looked: datetime | None


class Review(BaseModel):
    """What a provider decided about a change."""

    decision: Literal["accept", "reject"]
    reason: str | None
    by: str = Field(description="The account that decided.")
    at: datetime
    map_version: str | None = Field(description="The map version that an accepted change made.")


class Change(Evidence):
    """A change of the map that the evidence speaks for, as of its revision."""

    model_config = ConfigDict(json_schema_extra={"examples": [_CHANGE_EXAMPLE, _MOVED_EXAMPLE]})

    id: int
    kind: Kind
    state: State
    revision: int = Field(description="Rises with every entry of the feed about this change.")
    map: str = Field(description="The map's name.")
    map_object_id: int | None = Field(description="The map feature it is about; of an accepted new one, its new id.")
    watch_id: int | None = Field(
        description="The watch feature by which vehicles check it: of what is new, moved or modified."
    )
    feature_class: str = Field(alias="class")
    sign: str | None
    value: str | None
    geometry: Point
    covariance_m2: tuple[float, float, float] = Field(description="xx, xy, yy in east-north.")
    ellipse95: Ellipse
    contributors_for: int = Field(
        description="Different vehicles whose evidence for existence still weighs: of what is at `geometry` now."
    )
    contributors_against: int
    passes: int
    first_seen: datetime | None = Field(description="This, and what else vehicles did, is told to the hour.")
    last_seen: datetime | None
    last_looked: datetime | None
    confirmed_at: datetime | None = Field(description="Since when the evidence stands, in the time of the reports.")
    policy_version: str = Field(description="Of the policy under which this was decided: GET /v1/policies/{version}.")
    trust_version: int | None = Field(
        default=None,
        description="Of the trust in contributors by which this was decided; 0: before the first, null: not recorded.",
    )
    first_evidence: datetime | None = Field(description="When the first report came that says so, in event time.")
    from_: Half | None = Field(alias="from", description="Moved, modified: what the map says, and where.")
    to: Half | None = Field(description="Moved, modified: what is there now, and where.")
    merged_into: int | None = Field(description="Withdrawn, because it is part of this watch feature.")
    joined_into: int | None = Field(description="Withdrawn, because it is a half of this change.")
    withdrawn_because: Because | None
    mapped_at: datetime | None = Field(description="When a version of the map first said so.")
    mapped_in: str | None = Field(description="Which version that was.")
    review: Review | None


class FeedEntry(BaseModel):
    """What the service said at one time about one change."""

    sequence: int
    said_at: datetime
    change: Change


class FeedPage(BaseModel):
    """Entries of the feed in their order, without gaps but for what the filters leave out."""

    entries: list[FeedEntry]
    next: str | None = Field(description="Where the following entries are; null: there are none yet.")
    last_sequence: int = Field(description="Everything up to here has been looked through: ask on with `after`.")


class Contribution(BaseModel):
    """What one vehicle reported within one hour, discounted once."""

    vehicle: str = Field(description="A pseudonym that holds within this change only.")
    time: datetime = Field(description="The hour; admins are told the second.")
    weight_for: float
    weight_against: float
    informativeness: float = Field(description="0: saw nothing; 1: leaves no doubt.")
    passes: int
    in_doubt: bool = Field(description="Whether the vehicle said that it was not to be trusted then.")
    folds: bool = Field(
        description="Whether it is part of the course. What saw nothing or is older than the window is not, nor what "
        "was said in doubt, unless `contributors_in_doubt` of the policy agreed and nobody said otherwise between."
    )
    position_residual_m: tuple[float, float] | None = Field(description="East and north of the change's place.")
    position_mahalanobis: float | None = Field(
        description="The same in standard deviations of both places: 95 % are below 2.45."
    )


class CourseStep(Evidence):
    """The evidence right after one contribution."""

    time: datetime
    vehicle: str
    standing: bool


class WouldFlip(BaseModel):
    """What would turn the change, if nothing else happened."""

    becomes: Literal["confirmed", "withdrawn"]
    by: Literal["misses", "detections"]
    vehicles: int | None = Field(description="How many further vehicles it would take; null: no number of them alone.")
    sentence: str


class HistoryEntry(BaseModel):
    """When a state of the change was published."""

    sequence: int
    said_at: datetime
    state: State
    revision: int


class Explanation(BaseModel):
    """The evidence behind a change, as stored."""

    as_of: datetime
    speaks_for: Literal["new", "deleted"] = Field(description="What it would be evidence of, standing alone.")
    stands: bool = Field(description="Whether it stands as of `as_of`.")
    stood_since: datetime | None
    fades_at: datetime | None = Field(description="When it stands no longer if nobody looks again.")
    contributors_for: int
    contributors_against: int
    evidence_now: Evidence = Field(description="Decayed to `as_of`.")
    prior_weight: float = Field(description="Weight of the map's own word, -ln(1 - existence_confidence).")
    contributions: list[Contribution]
    course: list[CourseStep] = Field(
        description="The newest informative contributions, folded one by one. Misses of a new feature that at most one "
        "vehicle has seen are told with the policy's `trust_against_one`, by which nothing is decided."
    )
    policy: dict[str, Any]
    trust_version: int | None = Field(
        description="Of the trust under which this was folded: the one in force when asked; `trust_version` of the "
        "change is the one under which it was decided."
    )
    would_flip: WouldFlip


class ExplainedChange(Change):
    """A change as last published, the evidence behind it, and what was said about it."""

    evidence: Explanation = Field(description="About what is there now; of a deleted feature, about what the map says.")
    evidence_from: Explanation | None = Field(description="Moved, modified: about what the map says.")
    history: list[HistoryEntry]


class ReviewRequest(BaseModel):
    """A provider's decision."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"decision": "accept"}, {"decision": "reject", "reason": "a poster"}]},
    )

    decision: Literal["accept", "reject"]
    reason: Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=1000)] | None = Field(
        None, description="Why; needed to reject."
    )
    version: Annotated[str, StringConstraints(min_length=1, max_length=200)] | None = Field(
        None, description="Name of the map version that accepting makes; without it, the imported one's plus a number."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.decision == "reject" and self.reason is None:
            raise ValueError("a rejection needs a reason")
        if self.decision == "reject" and self.version is not None:
            raise ValueError("a rejection makes no map version")
        for name, value in (("reason", self.reason), ("version", self.version)):
            if value is not None and not value.replace("\n", "").isprintable():
                raise ValueError(f"{name} must be printable")
        return self
