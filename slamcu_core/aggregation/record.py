"""A contributor's record: how what it said fares against what others said before and after, each with one voice.

Nobody is judged by himself, nor by few: it takes three other contributors who agree, of at most eight who looked
nearest in time. So three colluders cannot make each other right, and an honest car is not wrong because two liars
followed it. What a contributor said is wrong if those who came after say otherwise and those before, or where they are
few the map, did not say the same: what was true when it was said is no lie when it has changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from slamcu_core.aggregation.contributions import EPOCH_S

VOICES = 8
"""Other contributors nearest in time that are heard, before and after each."""

QUORUM = 3
"""Of these must agree, at least …"""

MAJORITY = 2, 3
"""… and at least two in three of those who said anything."""


class About(StrEnum):
    """What a testimony is about: it tells how hard it is to be right by chance."""

    MAPPED = "mapped"  # a map feature: whoever has the map can say that it is there
    CANDIDATE = "candidate"  # a find, or an answer about a watch feature: only who drove there knows


@dataclass(frozen=True, slots=True)
class Testimony:
    """What one pass said about one thing."""

    contributor: int
    session: str
    time: float  # s of POSIX time
    exists: bool
    find: bool = False  # nobody had told it to look
    heard: bool = True  # False: it is judged, but judges nobody (its session is gated)


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a testimony fared."""

    testimony: Testimony
    about: About
    right: bool
    shared: bool  # a find of what others found too


@dataclass(frozen=True, slots=True)
class Tally:
    """Verdicts, counted; a contributor says one thing an hour about each thing."""

    right: int = 0
    wrong: int = 0
    right_claims: int = 0  # of these about candidates
    wrong_claims: int = 0
    false_finds: int = 0  # of the wrong claims: finds that no other contributor found
    conspired: int = 0  # of the wrong claims: finds that another contributor found too

    @property
    def judged(self) -> int:
        """How many there are."""
        return self.right + self.wrong


def judge(testimonies: Iterable[Testimony], about: About) -> list[Verdict]:
    """Judge what was said about one thing; what few others speak about is not judged.

    One contributor's testimonies of one epoch that say the same are one.
    """
    said: dict[tuple[int, int, bool], Testimony] = {}
    for item in sorted(testimonies, key=lambda item: (item.time, item.contributor, item.session)):
        said.setdefault((item.contributor, int(item.time // EPOCH_S), item.exists), item)
    ordered = list(said.values())
    finders = {item.contributor for item in ordered if item.find and item.exists}
    verdicts = []
    for index, item in enumerate(ordered):
        after = _consensus(item.contributor, ordered[index + 1 :])
        if after is None:
            continue
        if after is not item.exists:
            before = _consensus(item.contributor, ordered[:index][::-1])
            if before is item.exists or (before is None and item.exists and about is About.MAPPED):
                continue  # so it was then
        shared = item.find and len(finders - {item.contributor}) > 0
        verdicts.append(Verdict(item, about, after is item.exists, shared))
    return verdicts


def tally(verdicts: Iterable[Verdict]) -> Tally:
    """Count verdicts."""
    right = wrong = right_claims = wrong_claims = false_finds = conspired = 0
    for one in verdicts:
        claim = one.about is About.CANDIDATE
        find = claim and one.testimony.find and not one.right
        right += one.right
        wrong += not one.right
        right_claims += claim and one.right
        wrong_claims += claim and not one.right
        false_finds += find and not one.shared
        conspired += find and one.shared
    return Tally(right, wrong, right_claims, wrong_claims, false_finds, conspired)


PRIOR_RIGHT, PRIOR_WRONG = 18.0, 2.0
"""Verdicts that everybody starts with, as of a car that misses one sign in ten (the Beta prior of being right)."""

FULL_FROM, NONE_BELOW = 0.8, 0.5
"""Who is right at least so often has all of the policy's trust; at the toss of a coin none is left but …"""

FLOOR = 0.05
"""… this share: below what makes a contribution informative, so it neither says, erases nor fills a window."""

CONSPIRED_WEIGHT = 5.0
"""What a false find weighs that others claim to have made too: clutter does not fall twice on one place."""

RECORD_CLAIMS, RECORD_RIGHT = 3, 0.75
"""Right claims about candidates that make a record, and their share: that a map feature is there tells the map."""

GATE_JUDGED, GATE_WRONG = 8, 0.5
"""A session is gated from so many verdicts, of which at least this share is wrong: a lost car, or a liar."""


def trust_share(counted: Tally) -> float:
    """Return the share of the policy's trust that a record earns, in steps of 0.05 so that it does not flutter.

    False finds that nobody else made weigh nothing: they are a camera's clutter, and one car never decides.
    """
    wrong = counted.wrong - counted.false_finds + (CONSPIRED_WEIGHT - 1.0) * counted.conspired
    right = counted.right + PRIOR_RIGHT
    often = right / (right + wrong + PRIOR_WRONG)
    share = (often - NONE_BELOW) / (FULL_FROM - NONE_BELOW)
    return min(max(round(share / FLOOR) * FLOOR, FLOOR), 1.0)


def has_record(counted: Tally) -> bool:
    """Whether a contributor has been right about candidates often enough, and mostly."""
    wrong = counted.wrong_claims - counted.false_finds
    right = counted.right_claims
    return right >= RECORD_CLAIMS and right >= RECORD_RIGHT * (right + wrong) and trust_share(counted) >= 1.0


def is_gated(session: Tally) -> bool:
    """Whether a session contradicts the others so much that nothing of it should count."""
    return session.judged >= GATE_JUDGED and session.wrong >= GATE_WRONG * session.judged


def _consensus(contributor: int, others: Sequence[Testimony]) -> bool | None:
    """Return what the nearest others say, each with one voice, the nearest; None if too few agree."""
    voices: dict[int, bool] = {}
    for item in others:
        if item.heard and item.contributor != contributor:
            voices.setdefault(item.contributor, item.exists)
            if len(voices) == VOICES:
                break
    for answer in (True, False):
        count = sum(voice is answer for voice in voices.values())
        if count >= QUORUM and count * MAJORITY[1] >= len(voices) * MAJORITY[0]:
            return answer
    return None
