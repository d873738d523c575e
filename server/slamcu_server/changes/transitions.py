"""What new evidence makes of a change: a pure decision, so that the feed's rules can be read and tested alone.

A change opens as `candidate` when the mass that speaks for it reaches half of what confirms it; it is `confirmed` when
the evidence stands, which takes different contributors, and `withdrawn` when the evidence has left or faded. The feed
stays quiet otherwise: a confirmed change is said again only when what a provider would act on has moved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation import ClassPolicy
from slamcu_core.evidence import masses_from_weights
from slamcu_core.geometry import LocalFrame
from slamcu_server.changes.belief import DENIED, IN_THE_MAP, Belief, Kind, State, Subject
from slamcu_server.changes.document import Document

POSITION_SHIFT_STD = 0.25
"""A confirmed change is said again when its place moved by more than this many published standard deviations."""

CONTRIBUTOR_SHARE = 0.2
"""… or when the number of contributors for or against it changed by more than this share (and by one at least)."""

FINEST_STD_M = 0.01
"""A place is taken for no more precise than this: a map may say of its features that it knows them exactly."""


@dataclass(frozen=True, slots=True)
class Voice:
    """A belief as it reads now."""

    subject: Subject
    belief: Belief
    standing: bool
    mass: float  # that speaks for the change
    faded: bool = False  # what stood does not stand any more, because nobody has looked


@dataclass(frozen=True, slots=True)
class Claim:
    """What one belief claims, or two together."""

    kind: Kind
    standing: bool
    feature: Voice | None = None  # of all but `new`
    candidate: Voice | None = None  # of all but `deleted`
    beside: Voice | None = None  # the other half, which does not stand

    @property
    def leading(self) -> Voice:
        """Who speaks for the claim: the candidate where there is one."""
        voice = self.candidate or self.feature
        if voice is None:
            raise ValueError("a claim needs somebody who speaks for it")
        return voice

    @property
    def mass(self) -> float:
        """The mass that speaks for all of it."""
        return min(voice.mass for voice in (self.feature, self.candidate) if voice is not None)

    @property
    def ends(self) -> tuple[int | None, int | None]:
        """The feature and the candidate that it is about."""
        return (
            None if self.feature is None else self.feature.subject.feature_id,
            None if self.candidate is None else self.candidate.subject.candidate_id,
        )


@dataclass(frozen=True, slots=True)
class Published:
    """A change as the feed last told it."""

    id: int
    map_id: int
    kind: Kind
    state: State
    revision: int
    document: Document
    feature_id: int | None = None
    candidate_id: int | None = None
    evidence_left: bool = False  # since it was rejected, the evidence has left

    @property
    def ends(self) -> tuple[int | None, int | None]:
        """The feature and the candidate that it is about."""
        return self.feature_id, self.candidate_id

    @property
    def joined(self) -> bool:
        """Whether it has become a half of another change."""
        return self.document.get("joined_into") is not None

    def is_about(self, *voices: Voice | None) -> bool:
        """Whether it is about one of these, and has not become a half of another change."""
        return not self.joined and any(
            (voice.subject.feature_id is not None and voice.subject.feature_id == self.feature_id)
            or (voice.subject.candidate_id is not None and voice.subject.candidate_id == self.candidate_id)
            for voice in voices
            if voice is not None
        )


@dataclass(frozen=True, slots=True)
class Transition:
    """The next entry of the feed about something."""

    state: State
    opens: bool  # a change of its own instead of a further revision


def decide(claim: Claim, published: Published | None, rules: ClassPolicy) -> Transition | None:
    """Return the next entry about a claim, or None to stay silent.

    Parameters
    ----------
    claim : what the evidence says now.
    published : the newest change about the same thing, if there is one.
    """
    if published is None:
        opening = State.CONFIRMED if claim.standing else State.CANDIDATE
        speaks = claim.standing or claim.mass >= rules.opening_mass
        return Transition(opening, opens=True) if speaks else None
    if published.state in IN_THE_MAP | DENIED:
        # An import can bring back what was accepted as deleted while the evidence still speaks against it.
        anew = claim.standing and (published.state in IN_THE_MAP or published.evidence_left)
        return Transition(State.CONFIRMED, opens=True) if anew else None
    following = _follow(claim, published, rules)
    return None if following is None else Transition(following, opens=False)


def may_speak(
    weight_for: NDArray[np.float64],
    weight_against: NDArray[np.float64],
    standing: NDArray[np.bool_],
    rules: ClassPolicy,
) -> NDArray[np.bool_]:
    """Return (N,), about which of N map features without a change something could be said, or could fade.

    Any that stands, that evidence prevails against, or whose deletion is worth more than what is dropped.
    """
    _, not_exists, _ = masses_from_weights(weight_for, weight_against)
    # rather one too many than one too few for rounding
    return np.asarray(standing | (weight_against > weight_for) | (not_exists >= (1.0 - 1e-6) * rules.closing_mass))


def _follow(claim: Claim, published: Published, rules: ClassPolicy) -> State | None:
    turned = (claim.kind, claim.ends) != (published.kind, published.ends)
    match published.state:
        case State.CANDIDATE | State.WITHDRAWN if claim.standing:
            return State.CONFIRMED
        case State.CANDIDATE if claim.mass < rules.closing_mass:
            return State.WITHDRAWN
        case State.CANDIDATE if turned:
            return State.CANDIDATE
        case State.CONFIRMED if not claim.standing:
            return State.WITHDRAWN
        case State.CONFIRMED if turned or is_material(claim, published.document):
            return State.CONFIRMED
    return None


def is_material(claim: Claim, document: Document) -> bool:
    """Whether a published document no longer tells what a provider would act on."""
    if claim.feature is not None and claim.candidate is not None:
        origin = document.get("from")
        if origin is None or _counts_differ(claim.feature.belief, origin):
            return True
    belief = claim.leading.belief
    return _counts_differ(belief, document) or _shift_in_std(belief, document) > POSITION_SHIFT_STD


def _counts_differ(belief: Belief, document: dict[str, Any]) -> bool:
    return any(
        abs(now - document[name]) > max(CONTRIBUTOR_SHARE * document[name], 0.5)
        for name, now in (
            ("contributors_for", belief.contributors_for),
            ("contributors_against", belief.contributors_against),
        )
    )


def _shift_in_std(belief: Belief, document: Document) -> float:
    lon, lat = (document.get("to") or document)["geometry"]["coordinates"]
    xx, xy, yy = (document.get("to") or document)["covariance_m2"]
    variances, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    shift = LocalFrame(lon, lat).to_local(belief.lon, belief.lat) @ axes
    return float(np.sqrt(np.sum(shift**2 / np.maximum(variances, FINEST_STD_M**2))))
