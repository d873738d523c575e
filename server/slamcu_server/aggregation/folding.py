"""From passes to what is believed, for any set of map features and connected groups.

Pure, so that a batch that folds a few of them and a rebuild that folds all cannot differ.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from slamcu_core.aggregation import Policy, Side
from slamcu_core.evidence import support
from slamcu_server.aggregation.evidence import Place, Summary, fuse_places, prevailing, summarize, witnesses
from slamcu_server.aggregation.membership import Membership, assign, group_by_reach
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.aggregation.reads import MappedFeature


@dataclass(frozen=True, slots=True)
class CandidateFold:
    """What is believed about one candidate."""

    membership: Membership
    passes: tuple[StoredPass, ...]  # its members and what was reported about its watch features
    summary: Summary
    place: Place
    sign: str | None
    value: str | None


@dataclass(frozen=True, slots=True)
class Partition:
    """The candidates that a set of passes makes."""

    memberships: tuple[Membership, ...]
    alone: tuple[StoredPass, ...]  # misses that are near no candidate

    @property
    def watch_ids(self) -> frozenset[int]:
        """Every id whose founding pass is in the partition."""
        ids = {item.candidate_id for item in self.memberships if item.candidate_id is not None}
        return frozenset(ids | {merged for item in self.memberships for merged in item.merged})

    @property
    def merged(self) -> dict[int, int]:
        """The ids that are part of another candidate now, each with that one's id."""
        return {
            merged: item.candidate_id
            for item in self.memberships
            for merged in item.merged
            if item.candidate_id is not None
        }


def partition(passes: Iterable[StoredPass], founded: Mapping[int, int], policy: Policy) -> Partition:
    """Split passes into candidates; `founded` gives the ids that are bound to founding passes."""
    memberships, alone = assign(group_by_reach(passes, policy.reach_m), founded, policy)
    return Partition(tuple(memberships), tuple(alone))


def fold_candidates(
    parts: Partition, watched: Mapping[int, Sequence[StoredPass]], policy: Policy
) -> list[CandidateFold]:
    """Fold each candidate's members and the passes over the watch features that it bears."""
    passes = [
        (*item.members, *(report for key in _ids(item) for report in watched.get(key, ())))
        for item in parts.memberships
    ]
    classes = [item.founder.feature_class for item in parts.memberships]
    folds: dict[int, CandidateFold] = {}
    for name in sorted(set(classes)):
        numbers = [number for number, each in enumerate(classes) if each == name]
        rules = policy.for_class(name)
        summaries = summarize(
            [passes[number] for number in numbers], rules, Side.NEW, may_expire=_named_a_watch_feature
        )
        kept = [
            tuple(one for one in passes[number] if one.id not in gone)
            for number, gone in (
                (number, frozenset(each.expired)) for number, each in zip(numbers, summaries, strict=True)
            )
        ]
        places = fuse_places(kept, rules)
        for number, mine, summary, place in zip(numbers, kept, summaries, places, strict=True):
            folds[number] = CandidateFold(parts.memberships[number], mine, summary, place, *prevailing(mine))
    return [folds[number] for number in range(len(classes))]


def fold_features(
    features: Iterable[MappedFeature], passes: Mapping[int, Sequence[StoredPass]], policy: Policy
) -> dict[int, Summary]:
    """Fold the passes over map features, each from its prior (eq. 3)."""
    by_class: dict[str, list[MappedFeature]] = {}
    for feature in features:
        by_class.setdefault(feature.feature_class, []).append(feature)
    summaries: dict[int, Summary] = {}
    for name, mine in by_class.items():
        made = summarize(
            [passes.get(feature.id, ()) for feature in mine],
            policy.for_class(name),
            Side.DELETED,
            prior_weights=support([feature.existence_confidence for feature in mine]).tolist(),
        )
        summaries.update(zip((feature.id for feature in mine), made, strict=True))
    return summaries


def members(candidate_id: int, passes: Sequence[StoredPass]) -> Membership | None:
    """Return a candidate's membership out of the passes that count for it as they are stored; None without any find."""
    mine = sorted((item for item in passes if item.clusters), key=lambda item: item.order)
    founder = next(iter(witnesses(mine)), None)
    return None if founder is None else Membership(candidate_id, founder, tuple(mine), ())


def _ids(item: Membership) -> list[int]:
    """Return the ids of the watch features that a candidate bears."""
    return [*item.merged] if item.candidate_id is None else [item.candidate_id, *item.merged]


def _named_a_watch_feature(item: StoredPass) -> bool:
    """Whether a candidate can do without a pass: those that cluster carry its identity."""
    return item.watch_id is not None
