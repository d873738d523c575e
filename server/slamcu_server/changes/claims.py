"""What beliefs claim of the map: each alone, or a deleted feature and a new one together. Pure.

Two halves are one `moved` or `modified` change once the deletion stands and a quorum speaks for the new half: where a
sign is known to be gone, what several have seen in its place or near it only says what became of it, and need not stand
by itself. Nothing is held up that a provider needs: a deletion that stands is told as such, and becomes the other kind
when enough have seen the new half. Only a new feature beside which a deletion is under way waits for it, because it
always stands earlier (two contributors, and no prior to overcome), until `pair_patience` contributors have seen it; in
the same place it is no second sign, and waits as long as the mapped one is denied at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from slamcu_core.aggregation import ClassPolicy, Policy, kept_at
from slamcu_server.aggregation.evidence import frame_at
from slamcu_server.changes.belief import DENIED, Belief, Beliefs, Kind, Pair, State, masses
from slamcu_server.changes.transitions import Claim, Published, Voice


@dataclass(frozen=True, slots=True)
class Voices:
    """Every belief as it reads now."""

    features: Mapping[int, Voice]
    candidates: Mapping[int, Voice]


def read(beliefs: Beliefs, policy: Policy, as_of: Mapping[int, datetime]) -> Voices:
    """Read beliefs as of a time of each map: what nobody has looked at for long has faded."""
    features: dict[int, Voice] = {}
    candidates: dict[int, Voice] = {}
    held = [belief for _, belief in beliefs.about]
    now = [as_of.get(subject.map_id) for subject, _ in beliefs.about]
    kept = [_kept(belief, at, policy) for belief, at in zip(held, now, strict=True)]
    for (subject, belief), mass, at in zip(beliefs.about, masses(held, kept), now, strict=True):
        faded = at is not None and belief.fades_at is not None and at >= belief.fades_at
        voice = Voice(subject, belief, belief.standing and not faded, mass, faded=faded)
        if subject.feature_id is not None:
            features[subject.feature_id] = voice
        elif subject.candidate_id is not None:
            candidates[subject.candidate_id] = voice
    return Voices(features, candidates)


def _kept(belief: Belief, as_of: datetime | None, policy: Policy) -> float:
    """Return what time has left of a belief."""
    if as_of is None or belief.last_informative is None:
        return 1.0
    rules = policy.for_class(belief.feature_class)
    return kept_at(belief.last_informative.timestamp(), as_of.timestamp(), rules)


def claims(voices: Voices, pairs: Iterable[Pair], known: Sequence[Published], policy: Policy) -> list[Claim]:
    """Return what is claimed: what speaks first, in an order that does not depend on what was folded when."""
    made: list[Claim] = []
    paired: set[tuple[bool, int]] = set()
    for one in pairs:
        feature, candidate = voices.features[one.feature_id], voices.candidates[one.candidate_id]
        rules = policy.for_class(feature.belief.feature_class)
        if not (_speaks(feature, rules) and _speaks(candidate, rules)):
            continue
        if _denied(feature, known) or _denied(candidate, known):
            continue  # the provider has spoken about one of them: the other speaks for itself
        confirmed = any(row.state is State.CONFIRMED for row in known if row.is_about(feature, candidate))
        waits = not confirmed and _waits(feature, candidate, rules)
        made.append(_together(one.kind, feature, candidate, rules, waits=waits))
        paired |= {(True, one.feature_id), (False, one.candidate_id)}
    for mapped, held in ((True, voices.features), (False, voices.candidates)):
        made += [_alone(held[key]) for key in sorted(held) if (mapped, key) not in paired]
    return sorted(made, key=lambda claim: not claim.standing and claim.mass < _closing(claim, policy))


def _together(kind: Kind, feature: Voice, candidate: Voice, rules: ClassPolicy, *, waits: bool) -> Claim:
    seen = candidate.standing or candidate.belief.contributors_for >= rules.contributors_new
    if feature.standing and not seen:
        return Claim(Kind.DELETED, standing=True, feature=feature, beside=candidate)
    if candidate.standing and not feature.standing and not waits:
        return Claim(Kind.NEW, standing=True, candidate=candidate, beside=feature)
    return Claim(kind, standing=feature.standing, feature=feature, candidate=candidate)


def _alone(voice: Voice) -> Claim:
    if voice.belief.kind is Kind.NEW:
        return Claim(Kind.NEW, standing=voice.standing, candidate=voice)
    return Claim(Kind.DELETED, standing=voice.standing, feature=voice)


def _speaks(voice: Voice, rules: ClassPolicy) -> bool:
    return voice.standing or voice.mass >= rules.closing_mass


def _closing(claim: Claim, policy: Policy) -> float:
    return policy.for_class(claim.leading.belief.feature_class).closing_mass


def _waits(feature: Voice, candidate: Voice, rules: ClassPolicy) -> bool:
    old, new = feature.belief, candidate.belief
    frame = frame_at(old.lon, old.lat)
    apart_m = float(np.hypot(*(frame.to_local(new.lon, new.lat) - frame.to_local(old.lon, old.lat))))
    return new.contributors_for < rules.pair_patience or apart_m <= rules.match_radius_m


def _denied(voice: Voice, known: Sequence[Published]) -> bool:
    """Whether the newest change about something was rejected, and its evidence has not left since."""
    mine = [row for row in known if row.is_about(voice)]
    newest = max(mine, key=lambda row: row.id, default=None)
    return newest is not None and newest.state in DENIED and not newest.evidence_left
