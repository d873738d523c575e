"""Which change goes on with which claim, and what the feed says next. Pure.

A change keeps its id while its kind goes from `new` or `deleted` to `moved` or `modified` and back. Where each half has
one, the older goes on and the other is withdrawn into it. Where two halves part, the change goes on with the deleted
feature if that still speaks, else with the candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from slamcu_core.aggregation import Policy
from slamcu_server.changes.belief import OPEN, Because, Beliefs, State
from slamcu_server.changes.transitions import Claim, Published, Voice, decide


@dataclass(frozen=True, slots=True)
class Said:
    """What the feed says next about a change."""

    state: State
    published: Published | None  # None: a change of its own
    claim: Claim | None  # None: nothing is left that speaks, the change ends as it was told
    why: dict[str, Any] = field(default_factory=dict)  # members of the document


def plan(claims: Sequence[Claim], beliefs: Beliefs, known: Sequence[Published], policy: Policy) -> list[Said]:
    """Return what is to be said, given what is claimed (what speaks first) and the changes there are about it."""
    said: list[Said] = []
    taken: set[int] = set()
    about = _by_end(known)
    for claim in claims:
        voices = [voice for voice in (claim.feature, claim.candidate, claim.beside) if voice is not None]
        near = {row.id: row for voice in voices for end in _ends(voice) for row in about.get(end, ())}
        mine = [near[key] for key in sorted(near) if key not in taken and near[key].is_about(*voices)]
        chosen, joined = _choose(mine)
        if chosen is not None and chosen.state in OPEN:
            taken |= {chosen.id, *(row.id for row in joined)}
        transition = decide(claim, chosen, policy.for_class(claim.leading.belief.feature_class))
        if transition is not None:
            why = {"withdrawn_because": _reason(claim, beliefs)} if transition.state is State.WITHDRAWN else {}
            said.append(Said(transition.state, None if transition.opens else chosen, claim, why))
            if chosen is not None and not transition.opens:
                taken.add(chosen.id)  # a withdrawn one that comes back is nobody else's either
        if chosen is not None:
            because = {"withdrawn_because": Because.JOINED.value, "joined_into": chosen.id}
            said += [Said(State.WITHDRAWN, row, None, because) for row in joined]
    return said + _moot([row for row in known if row.id not in taken and row.state in OPEN], beliefs)


def _by_end(known: Sequence[Published]) -> dict[tuple[int | None, int | None], list[Published]]:
    """Return changes by each of the things that they are about."""
    about: dict[tuple[int | None, int | None], list[Published]] = {}
    for row in known:
        for end in {(row.feature_id, None), (None, row.candidate_id)} - {(None, None)}:
            about.setdefault(end, []).append(row)
    return about


def _ends(voice: Voice) -> list[tuple[int | None, int | None]]:
    return [(voice.subject.feature_id, None), (None, voice.subject.candidate_id)]


def _choose(mine: Sequence[Published]) -> tuple[Published | None, list[Published]]:
    """Return the change that goes on, and open ones that are joined into it."""
    still_open = sorted((row for row in mine if row.state in OPEN), key=lambda row: row.id)
    if still_open:
        return still_open[0], still_open[1:]
    return max(mine, key=lambda row: row.id, default=None), []


def _reason(claim: Claim, beliefs: Beliefs) -> str:
    voices = [voice for voice in (claim.feature, claim.candidate) if voice is not None]
    if any(voice.faded for voice in voices):
        return Because.FADED.value
    return (Because.RETRACTED if beliefs.corrected else Because.EVIDENCE).value


def _moot(rows: Sequence[Published], beliefs: Beliefs) -> list[Said]:
    """Withdraw what is open about things that say nothing by themselves any more."""
    said: list[Said] = []
    for row in sorted(rows, key=lambda row: row.id):
        why: dict[str, Any] | None = None
        into = None if row.candidate_id is None else beliefs.merged.get(row.candidate_id)
        if into is not None:
            why = {"withdrawn_because": Because.MERGED.value, "merged_into": into}
        elif row.candidate_id in beliefs.dissolved:
            why = {"withdrawn_because": Because.RETRACTED.value}
        elif row.feature_id in beliefs.unmapped:
            why = {"withdrawn_because": Because.UNMAPPED.value}
        if why is not None:
            said.append(Said(State.WITHDRAWN, row, None, why))
    return said
