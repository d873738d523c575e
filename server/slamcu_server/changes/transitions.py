"""What new evidence makes of a change: a pure decision, so that the feed's rules can be read and tested alone.

A change opens as `candidate` when the mass that speaks for it reaches half of what confirms it; it is `confirmed` when
the evidence stands, which takes different contributors, and `withdrawn` when the evidence has left. The feed stays
quiet otherwise: a confirmed change is said again only when what a provider would act on has moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamcu_core.evidence import masses_from_weights
from slamcu_server.changes.belief import Belief, Kind, State
from slamcu_server.changes.document import Document

OPENING_SHARE = 0.5
"""A change opens as candidate at this share of the mass that confirms it."""

POSITION_SHIFT_STD = 0.25
"""A confirmed change is said again when its place moved by more than this many published standard deviations."""

CONTRIBUTOR_SHARE = 0.2
"""… or when the number of contributors for or against it changed by more than this share (and by one at least)."""


@dataclass(frozen=True, slots=True)
class Published:
    """A change as the feed last told it."""

    id: int
    map_id: int
    state: State
    revision: int
    document: Document
    evidence_left: bool = False  # since it was rejected, the evidence has left


@dataclass(frozen=True, slots=True)
class Transition:
    """The next entry of the feed about something."""

    state: State
    opens: bool  # a change of its own instead of a further revision


def decide(belief: Belief, published: Published | None, *, enter: float) -> Transition | None:
    """Return the next entry about a belief, or None to stay silent.

    Parameters
    ----------
    belief : the evidence now.
    published : the newest change about the same thing, if there is one.
    enter : the mass that confirms, from the policy.
    """
    if published is None:
        opening = State.CONFIRMED if belief.standing else State.CANDIDATE
        speaks = belief.standing or _mass(belief) >= OPENING_SHARE * enter
        return Transition(opening, opens=True) if speaks else None
    if published.state in (State.ACCEPTED, State.REJECTED):
        # An import can bring back what was accepted as deleted while the evidence still speaks against it.
        anew = belief.standing and (published.state is State.ACCEPTED or published.evidence_left)
        return Transition(State.CONFIRMED, opens=True) if anew else None
    following = _follow(belief, published, enter)
    return None if following is None else Transition(following, opens=False)


def _follow(belief: Belief, published: Published, enter: float) -> State | None:
    match published.state:
        case State.CANDIDATE | State.WITHDRAWN if belief.standing:
            return State.CONFIRMED
        case State.CANDIDATE if _mass(belief) < OPENING_SHARE**2 * enter:
            return State.WITHDRAWN
        case State.CONFIRMED if not belief.standing:
            return State.WITHDRAWN
        case State.CONFIRMED if is_material(belief, published.document):
            return State.CONFIRMED
    return None


def leaves(belief: Belief, published: Published | None) -> bool:
    """Whether the evidence that a rejected change was about has left, which must be remembered: it may come again."""
    return published is not None and published.state is State.REJECTED and not belief.standing


def is_material(belief: Belief, document: Document) -> bool:
    """Whether a published document no longer tells what a provider would act on."""
    for name, now in (
        ("contributors_for", belief.contributors_for),
        ("contributors_against", belief.contributors_against),
    ):
        if abs(now - document[name]) > max(CONTRIBUTOR_SHARE * document[name], 0.5):
            return True
    return _shift_in_std(belief, document) > POSITION_SHIFT_STD


def _mass(belief: Belief) -> float:
    exists, not_exists, _ = masses_from_weights(belief.weight_for, belief.weight_against)
    return float(exists if belief.kind is Kind.NEW else not_exists)


def _shift_in_std(belief: Belief, document: Document) -> float:
    lon, lat = document["geometry"]["coordinates"]
    north_m = np.deg2rad(belief.lat - lat) * 6_371_000.0
    east_m = np.deg2rad(belief.lon - lon) * 6_371_000.0 * np.cos(np.deg2rad(lat))
    xx, xy, yy = document["covariance_m2"]
    shift = np.array([east_m, north_m])
    return float(np.sqrt(shift @ np.linalg.solve(np.array([[xx, xy], [xy, yy]]), shift)))
