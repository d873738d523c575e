"""What a drive comes to, as a few lines for people: what became of the map, what was found, what was on watch."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from slamcu_core.filter import FeatureEstimate
from slamcu_core.formats import ChangeState
from slamcu_core.hd_map import HDMap

_OF_THE_MAP = (
    ChangeState.NORMAL,
    ChangeState.DELETED,
    ChangeState.MOVED,
    ChangeState.MODIFIED,
    ChangeState.UNCLASSIFIED,
)
_THERE, _NOT_THERE, _UNDECIDED = "there", "not there", "undecided"


def summary_lines(hd_map: HDMap, estimates: Iterable[FeatureEstimate]) -> Iterator[str]:
    """Count what a session believes, each feature once.

    The map's own features add up to those of the map; what the car found and what the cloud has put on watch are not
    in the map, and are counted apart.
    """
    mapped: Counter[ChangeState] = Counter()
    found: Counter[ChangeState] = Counter()
    watched: Counter[str] = Counter()
    never = 0
    for one in estimates:
        state = ChangeState(one.state)
        if one.feature is None:
            found[state] += 1
        elif one.feature.watched:
            watched[_verdict(one)] += 1
        else:
            mapped[state] += 1
            never += state is ChangeState.UNCLASSIFIED and one.passes == 0
    identity = hd_map.identity
    yield f"map {identity.source or '(no name)'} {identity.version}: {mapped.total()} features"
    for state in _OF_THE_MAP:
        note = f"{never} of them never in view" if state is ChangeState.UNCLASSIFIED and never else ""
        yield _row(state.value, mapped[state], note)
    yield "not in the map"
    yield _row(ChangeState.NEW.value, found[ChangeState.NEW])
    if unproven := found.total() - found[ChangeState.NEW]:
        yield _row(ChangeState.UNCLASSIFIED.value, unproven, "seen too little to tell")
    candidates = sum(feature.watched for feature in hd_map)
    if candidates:
        # what is not among the estimates is what a sign of the map has become (`kinds`)
        watched[_THERE] += candidates - watched.total()
        yield f"on watch for the cloud: {candidates} candidates"
        yield from (_row(verdict, watched[verdict]) for verdict in (_THERE, _NOT_THERE, _UNDECIDED))


def _verdict(one: FeatureEstimate) -> str:
    """Say what this car makes of a candidate: the largest mass decides, as it does over features of the map."""
    masses = one.masses
    if one.passes == 0 or masses.unknown >= max(masses.exists, masses.not_exists):
        return _UNDECIDED
    return _THERE if masses.exists > masses.not_exists else _NOT_THERE


def _row(name: str, count: int, note: str = "") -> str:
    return f"  {name:<12} {count:>7}" + (f"   {note}" if note else "")
