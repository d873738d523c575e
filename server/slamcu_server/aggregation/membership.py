"""Which passes are one candidate, and which id it has: recomputed over whole connected groups, in canonical order.

An id is bound for ever to the pass that founded it. A cluster bears the lowest of the ids whose founding passes are in
it; the others are merged into that one, and live again by themselves if the clusters part. What vehicles report about
a watch feature follows the founding pass of its id.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from slamcu_core.aggregation import Passes, Policy, cluster, connected_groups
from slamcu_core.aggregation.groups import root_of
from slamcu_core.geometry import LocalFrame
from slamcu_server.aggregation.cells import Cell, keys_within
from slamcu_server.aggregation.evidence import covariances, frame_at
from slamcu_server.aggregation.passes import StoredPass


@dataclass(frozen=True, slots=True)
class Membership:
    """One cluster of a group, and the id it bears."""

    candidate_id: int | None  # None: new, to be bound to its founder
    founder: StoredPass
    members: tuple[StoredPass, ...]
    merged: tuple[int, ...]  # other ids whose founding passes are members


def group_by_reach(passes: Iterable[StoredPass], reach_m: float) -> list[list[StoredPass]]:
    """Split passes into groups that steps of at most `reach_m` connect, each in canonical order.

    Distances are measured in the frames of the cells, never in one frame over all passes, so that a group is the same
    whatever else is looked at with it.
    """
    ordered = sorted(passes, key=lambda item: item.order)
    in_cell: defaultdict[int, list[int]] = defaultdict(list)
    places = [_place(item) for item in ordered]
    lon, lat = [place[0] for place in places], [place[1] for place in places]
    numbers, keys = keys_within([item.map_id for item in ordered], lon, lat, reach_m)
    for index, key in zip(numbers.tolist(), keys.tolist(), strict=True):
        in_cell[key].append(index)
    parent = list(range(len(ordered)))
    for key, indices in in_cell.items():
        west, south, east, north = Cell.of_key(key).bounds
        frame = LocalFrame((west + east) / 2, (south + north) / 2)
        xy = frame.to_local([lon[index] for index in indices], [lat[index] for index in indices])
        labels = connected_groups(xy, reach_m)
        first: dict[int, int] = {}
        for index, label in zip(indices, labels.tolist(), strict=True):
            one, other = root_of(parent, first.setdefault(label, index)), root_of(parent, index)
            parent[max(one, other)] = min(one, other)
    groups: defaultdict[int, list[StoredPass]] = defaultdict(list)
    for index, item in enumerate(ordered):
        groups[root_of(parent, index)].append(item)
    return [groups[root] for root in sorted(groups)]


def assign(
    groups: Sequence[Sequence[StoredPass]], founded: Mapping[int, int], policy: Policy
) -> tuple[list[Membership], list[StoredPass]]:
    """Cluster connected groups and say which candidate each cluster is.

    Parameters
    ----------
    groups : each of one map, of passes that cluster, in canonical order.
    founded : ids of candidates by the id of their founding pass.

    Returns
    -------
    The clusters, group by group in the order of their founders, and the misses that are near none.
    """
    memberships: list[Membership] = []
    alone: list[StoredPass] = []
    several = iter(cluster([_passes(group) for group in groups if len(group) > 1], policy))
    for group in groups:
        if len(group) == 1:  # as many are
            (item,) = group
            if item.found:
                memberships.append(Membership(founded.get(item.id), item, (item,), ()))
            else:
                alone.append(item)
            continue
        clusters = next(several)
        members: list[list[StoredPass]] = [[] for _ in clusters.founders]
        for item, label in zip(group, clusters.labels.tolist(), strict=True):
            (members[label] if label >= 0 else alone).append(item)
        for founder, mine in zip(clusters.founders.tolist(), members, strict=True):
            ids = sorted(founded[item.id] for item in mine if item.id in founded)
            memberships.append(Membership(ids[0] if ids else None, group[founder], tuple(mine), tuple(ids[1:])))
    return memberships, alone


def _passes(group: Sequence[StoredPass]) -> Passes:
    places = [_place(item) for item in group]
    frame = frame_at(places[0][0], places[0][1])
    return Passes(
        xy=frame.to_local([p[0] for p in places], [p[1] for p in places]),
        covariance=covariances([p[2] for p in places]),
        evidence_sign=[1 if item.found else -1 for item in group],
        group_key=[item.feature_class for item in group],
        sign=[item.sign for item in group],
        value=[item.value for item in group],
        doubtful=[not item.trusted for item in group],
        observer=[item.key[:2] for item in group],
        interval=[(item.started_at.timestamp(), item.ended_at.timestamp()) for item in group],
        order_key=[item.order for item in group],
    )


def _place(item: StoredPass) -> tuple[float, float, tuple[float, float, float]]:
    if item.place is None:
        raise ValueError(f"pass {item.id} has no place to cluster by")
    return item.place
