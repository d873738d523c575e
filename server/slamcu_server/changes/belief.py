"""What the evidence says about one thing, map feature or candidate: what changes are decided on and published from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slamcu_core.evidence import masses_from_weights


class Kind(StrEnum):
    """The kinds of change; `moved` and `modified` join a map feature with a candidate."""

    NEW = "new"
    DELETED = "deleted"
    MOVED = "moved"
    MODIFIED = "modified"


class State(StrEnum):
    """The states of a change: evidence moves the first three, a review the next two, an imported map the last two."""

    CANDIDATE = "candidate"
    CONFIRMED = "confirmed"
    WITHDRAWN = "withdrawn"
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    ABSORBED = "absorbed"
    CONTRADICTED = "contradicted"


OPEN = frozenset({State.CANDIDATE, State.CONFIRMED})
"""What a provider can decide on: a withdrawn change has nothing left to accept or reject."""

IN_THE_MAP = frozenset({State.ACCEPTED, State.ABSORBED})
"""The map says so now."""

DENIED = frozenset({State.REJECTED, State.CONTRADICTED})
"""The provider knows better: the change stays silent until the evidence for it has left and come again."""


class Because(StrEnum):
    """Why a change was withdrawn."""

    EVIDENCE = "evidence"  # it turned, or left
    FADED = "faded"  # nobody has looked for too long
    MERGED = "merged"  # the candidate is part of another one
    JOINED = "joined"  # it is one half of another change now
    UNMAPPED = "unmapped"  # the map no longer has the feature
    RETRACTED = "retracted"  # what it was made of was taken out, or what speaks against it let in again


@dataclass(frozen=True, slots=True)
class Subject:
    """What a change is about: a feature of a map, or a candidate near it."""

    kind: Kind
    map_id: int
    feature_id: int | None = None
    map_object_id: int | None = None
    candidate_id: int | None = None  # the id of its watch feature


@dataclass(frozen=True, slots=True)
class Belief:
    """The folded evidence about one map feature or candidate, and what it is.

    Weights are those of the last informative contribution's time: decay is applied when reading.
    """

    kind: Kind  # what it would be a change of: new for candidates, deleted for map features
    weight_for: float
    weight_against: float
    standing: bool
    stood_since: datetime | None
    contributors_for: int
    contributors_against: int
    passes: int
    first_seen: datetime | None
    last_seen: datetime | None
    last_looked: datetime | None
    last_informative: datetime | None
    feature_class: str
    sign: str | None
    value: str | None
    lon: float  # degrees
    lat: float
    covariance_m2: tuple[float, float, float]  # xx, xy, yy in east-north
    policy_version: str
    order: tuple[Any, ...] = ()  # canonical among beliefs of one kind
    begun: tuple[datetime | None, datetime | None] = (None, None)  # it came about between these; None: no bound
    heading_deg: float | None = None  # compass direction that the map says its face looks
    fades_at: datetime | None = None  # when it stands no longer if nobody looks again

    @property
    def mass(self) -> float:
        """The mass that speaks for the change, as of the last informative contribution."""
        return masses([self])[0]

    @property
    def first_evidence(self) -> datetime | None:
        """When somebody first saw that the map is wrong, as far as it is still known."""
        return self.begun[1]


def masses(beliefs: Sequence[Belief], kept: ArrayLike = 1.0) -> list[float]:
    """Return the mass that speaks for each change, of what is left of its weights: `kept` in [0, 1] of each."""
    left = np.broadcast_to(np.asarray(kept, float), (len(beliefs),))
    exists, not_exists, _ = masses_from_weights(
        left * [one.weight_for for one in beliefs], left * [one.weight_against for one in beliefs]
    )
    found: list[float] = np.where([one.kind is Kind.NEW for one in beliefs], exists, not_exists).tolist()
    return found


@dataclass(frozen=True, slots=True)
class Pair:
    """A map feature and a candidate that are one change once both stand."""

    kind: Kind  # moved or modified
    feature_id: int
    candidate_id: int


@dataclass(frozen=True, slots=True)
class Beliefs:
    """What is believed about everything that was folded again."""

    about: tuple[tuple[Subject, Belief], ...]
    merged: Mapping[int, int]  # candidates that are part of another one now, each with that one's id
    unmapped: frozenset[int]  # features that the map no longer has: nothing about them would be a change of it
    dissolved: frozenset[int] = frozenset()  # candidates of which nothing is left: what they were made of was retracted
    pairs: tuple[Pair, ...] = ()  # of features and candidates that are both in `about`
    corrected: bool = False  # what counts was changed: by a retraction, its undoing, or trust
