"""What each pass of a message is about: map feature, watch feature, or a find that only its place tells.

A message is taken or refused whole, here as at the door: one pass that names something nobody has ever mapped, and the
whole message goes to quarantine with the reason, because a vehicle that is wrong about one id may be wrong about all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from slamcu_core.aggregation import Policy
from slamcu_core.errors import SlamcuError
from slamcu_core.reports import ReportMessage
from slamcu_server.aggregation.cells import Cell, cells_within
from slamcu_server.aggregation.evidence import frame_at
from slamcu_server.aggregation.passes import StoredPass


class UnresolvableError(SlamcuError):
    """A message that cannot be read as evidence about any map this server has."""


@dataclass(frozen=True, slots=True)
class ClaimedMessage:
    """A message of the log that this transaction holds."""

    id: int
    account_id: int
    session_id: str
    message_id: int
    body: bytes
    region: int = 0  # where it is from: `cells.region_at`


@dataclass(frozen=True, slots=True)
class MapFeatureReference:
    """A map feature, and where it was first mapped: that place never changes, so its cell is what to lock."""

    id: int
    lon: float
    lat: float
    since_sequence: int = 0  # the first map version in which it was this thing at this place


@dataclass(frozen=True, slots=True)
class WatchReference:
    """A watch feature: the candidate it is now part of, or the map feature it has become, and its founding place."""

    id: int
    map_id: int
    candidate_id: int
    feature_id: int | None
    lon: float
    lat: float


@dataclass(frozen=True, slots=True)
class NearbyFeature:
    """A feature of the current map near an unreferenced pass."""

    id: int
    since_sequence: int  # the first map version that had this thing at this place
    feature_class: str
    sign: str | None
    value: str | None
    position_std_m: float
    lon: float
    lat: float


@dataclass(frozen=True, slots=True)
class Lookups:
    """What the database knows about the things that messages name."""

    versions: Mapping[tuple[str, str], tuple[int, int]]  # (source, version) to (map id, sequence)
    features: Mapping[tuple[int, int], MapFeatureReference]  # by (map id, object id)
    watches: Mapping[int, WatchReference]
    current: Mapping[int, int] = field(default_factory=dict)  # current sequence by map id


@dataclass(frozen=True, slots=True)
class ResolvedMessage:
    """A message with what its passes are about; the passes have no ids of their own yet."""

    claimed: ClaimedMessage
    report: ReportMessage
    map_sequence: int
    passes: tuple[StoredPass, ...]
    anchors: tuple[tuple[int, float, float], ...] = field(default=())  # (map id, lon, lat) of what they touch

    def cells(self, reach_m: float) -> frozenset[Cell]:
        """Return the cells that folding this message must hold."""
        return frozenset[Cell]().union(*(cells_within(*anchor, reach_m) for anchor in self.anchors))


class _About(NamedTuple):
    """What a pass is about."""

    feature_id: int | None = None
    watch_id: int | None = None
    candidate_id: int | None = None
    archived: bool = False


_NOTHING = _About()


def resolve_message(claimed: ClaimedMessage, report: ReportMessage, known: Lookups) -> ResolvedMessage:
    """Tie the passes of a message to what they name.

    Raises UnresolvableError naming the map, version or pass that this server does not know.
    """
    identity = report.map_identity
    try:
        map_id, sequence = known.versions[identity.source, identity.version]
    except KeyError:
        raise UnresolvableError(f"map {identity.source!r} version {identity.version!r} is not known here") from None
    passes: list[StoredPass] = []
    anchors: set[tuple[int, float, float]] = set()
    for index, item in enumerate(report.passes):
        reference = item.reference
        if reference is None:
            about = _NOTHING
            if item.position is not None:
                anchors.add((map_id, item.position.lon, item.position.lat))
        elif reference.watched:
            watch = known.watches.get(reference.object_id)
            if watch is None or watch.map_id != map_id:
                raise UnresolvableError(
                    f"passes[{index}]: map {identity.source!r} has no watch feature {reference.object_id}"
                )
            # The candidate may have been accepted meanwhile: then this is evidence about the map feature it became.
            about = _About(watch.feature_id, watch.id, None if watch.feature_id else watch.candidate_id)
            anchors.add((map_id, watch.lon, watch.lat))
        else:
            feature = known.features.get((map_id, reference.object_id))
            if feature is None:
                raise UnresolvableError(
                    f"passes[{index}]: map {identity.source!r} never had a feature {reference.object_id}"
                )
            # Who has an older map speaks of what it was, or of where it was.
            about = _About(feature.id, archived=sequence < feature.since_sequence)
            anchors.add((map_id, feature.lon, feature.lat))
        passes.append(_stored(claimed, report, index, map_id, about))
    return ResolvedMessage(claimed, report, sequence, tuple(passes), tuple(sorted(anchors)))


def match_feature(
    item: StoredPass, map_sequence: int, nearby: Iterable[NearbyFeature], policy: Policy
) -> NearbyFeature | None:
    """Return the map feature that an unreferenced pass is about although it does not name it, or None.

    A car with an older map finds as new what has been accepted since; a third party may expect a feature without
    saying which. The nearest of the same type within the gate is meant.
    """
    place = item.place
    if place is None or not item.counts:
        return None
    lon, lat, (xx, xy, yy) = place
    rules = policy.for_class(item.feature_class)
    frame = frame_at(lon, lat)
    origin = frame.to_local(lon, lat)
    best: tuple[float, int] | None = None
    matched: NearbyFeature | None = None
    for feature in nearby:
        if item.clusters and feature.since_sequence <= map_sequence:
            continue  # the car knew this feature, and says that its find is another
        if feature.feature_class != item.feature_class or not _compatible(item, feature):
            continue
        shift = frame.to_local(feature.lon, feature.lat) - origin
        own = feature.position_std_m**2 + rules.position_floor_m**2
        spread = np.array([[xx + own, xy], [xy, yy + own]])
        squared = float(shift @ np.linalg.solve(spread, shift))
        inside = squared <= rules.gate and float(np.hypot(*shift)) <= rules.match_radius_m
        if inside and (best is None or (squared, feature.id) < best):
            best, matched = (squared, feature.id), feature
    return matched


def within_budget(
    messages: Sequence[ResolvedMessage], reach_m: float, budget: int, extra: frozenset[Cell]
) -> tuple[list[ResolvedMessage], frozenset[Cell]]:
    """Return the longest prefix of messages whose cells are at most `budget`, at least one message, and the cells."""
    cells, taken = extra, list[ResolvedMessage]()
    for message in messages:
        more = cells | message.cells(reach_m)
        if taken and len(more) > budget:
            break
        cells = more
        taken.append(message)
    return taken, cells


def _compatible(item: StoredPass, feature: NearbyFeature) -> bool:
    return all(
        seen is None or mapped is None or seen == mapped
        for seen, mapped in ((item.sign, feature.sign), (item.value, feature.value))
    )


def _stored(claimed: ClaimedMessage, report: ReportMessage, index: int, map_id: int, about: _About) -> StoredPass:
    item = report.passes[index]
    return StoredPass(
        id=0,
        key=(claimed.account_id, claimed.session_id, claimed.message_id, index),
        map_id=map_id,
        started_at=item.started_at,
        ended_at=item.ended_at,
        status=item.status,
        feature_class=item.feature_class,
        sign=item.sign,
        value=item.value,
        weight_for=item.weight_for,
        weight_against=item.weight_against,
        valid=item.valid,
        trusted=report.health.trusted,
        feature_id=about.feature_id,
        watch_id=about.watch_id,
        candidate_id=about.candidate_id,
        archived=about.archived,
        lon=item.position.lon if item.position else None,
        lat=item.position.lat if item.position else None,
        covariance_m2=item.position.covariance_m2 if item.position else None,
    )
