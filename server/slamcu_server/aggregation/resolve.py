"""What each pass of a message is about: map feature, watch feature, or a find that only its place tells.

A message is taken or refused whole, here as at the door: one pass that names something nobody has ever mapped, and the
whole message goes to quarantine with the reason, because a vehicle that is wrong about one id may be wrong about all.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation.cells import Cell, keys_within
from slamcu_server.aggregation.condensed import NAMES, PLACED, STATUSES, VALID, WATCHED, Reported, instants
from slamcu_server.aggregation.evidence import frame_at
from slamcu_server.aggregation.lookups import Lookups, WatchReference
from slamcu_server.aggregation.passes import StoredPass

Indices = NDArray[np.intp]
Ids = NDArray[np.int64]


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
class Resolved:
    """P passes of M messages with what they are about."""

    reported: Reported
    map_id: Ids  # (M,)
    map_sequence: Ids  # (M,)
    feature_id: Ids  # (P,), the map feature, 0 for none
    watch_id: Ids  # (P,), the watch feature that it named, 0 for none
    candidate_id: Ids  # (P,), the candidate that this is part of now, 0 for none
    archived: NDArray[np.bool_]  # (P,), whether it speaks of what its map feature was, or of where it was
    anchor: NDArray[np.float64]  # (P, 2), degrees: where what it touches is locked, NaN where it touches nothing

    @property
    def plain(self) -> NDArray[np.bool_]:
        """(P,), whether a pass names the map feature it is about: nothing that others report can make it another."""
        return np.asarray((self.feature_id > 0) & (self.watch_id == 0))

    @property
    def messages(self) -> int:
        """How many messages there are."""
        return len(self.map_id)

    def keys(self, reach_m: float) -> tuple[Indices, Ids]:
        """Return the cells that folding these passes must hold, by their keys, and the message that each is for."""
        anchored = np.flatnonzero(~np.isnan(self.anchor[:, 0]))
        message = self.reported.message[anchored]
        # what many passes touch is looked at once
        table = np.column_stack([message.astype(float), self.anchor[anchored]])
        distinct = _distinct(table)
        which = distinct[:, 0].astype(np.intp)
        number, keys = keys_within(self.map_id[which], distinct[:, 1], distinct[:, 2], reach_m)
        return which[number], keys

    def only(self, messages: NDArray[np.bool_]) -> Resolved:
        """Return some messages, (M,)."""
        if messages.all():
            return self
        passes = messages[self.reported.message]
        return Resolved(
            self.reported.without(np.flatnonzero(~messages).tolist()),
            self.map_id[messages],
            self.map_sequence[messages],
            self.feature_id[passes],
            self.watch_id[passes],
            self.candidate_id[passes],
            self.archived[passes],
            self.anchor[passes],
        )


def resolve(reported: Reported, known: Lookups) -> tuple[Resolved, dict[int, str]]:
    """Tie passes to what they name, and say by their ids why some messages cannot be: these are left out."""
    identities = [known.versions.get((one.source, one.version)) for one in reported.envelopes]
    reasons = {
        number: f"map {one.source!r} version {one.version!r} is not known here"
        for number, (one, identity) in enumerate(zip(reported.envelopes, identities, strict=True))
        if identity is None
    }
    map_id = reported.of_messages([0 if identity is None else identity[0] for identity in identities], np.int64)
    sequence = reported.of_messages([0 if identity is None else identity[1] for identity in identities], np.int64)
    named, watched, placed = reported.has(NAMES), reported.has(WATCHED), reported.has(PLACED)
    records, features = reported.records, known.features

    at = np.full(len(records), -1, np.intp)
    mapped = np.flatnonzero(named & ~watched)
    at[mapped] = features.find(map_id[mapped], records["object_id"][mapped])
    watches: dict[int, WatchReference] = {
        number: watch
        for number in np.flatnonzero(watched).tolist()
        if (watch := known.watches.get(int(records["object_id"][number]))) is not None
        and watch.map_id == map_id[number]
    }
    lost = named & (at < 0)
    lost[list(watches)] = False
    for number in np.flatnonzero(lost).tolist():
        message = int(reported.message[number])
        kind = "has no watch feature" if watched[number] else "never had a feature"
        what = f"passes[{reported.index[number]}]: map {reported.envelopes[message].source!r} {kind}"
        reasons.setdefault(message, f"{what} {records['object_id'][number]}")
    if reasons:
        resolved, none = resolve(reported.without(sorted(reasons)), known)
        return resolved, {reported.claimed[number].id: why for number, why in reasons.items()} | none

    feature_id, watch_id, candidate_id = (np.zeros(len(records), np.int64) for _ in range(3))
    archived = np.zeros(len(records), bool)
    anchor = np.full((len(records), 2), np.nan)
    feature_id[mapped] = features.id[at[mapped]]
    # Who has an older map speaks of what it was, or of where it was.
    archived[mapped] = sequence[mapped] < features.since[at[mapped]]
    anchor[mapped] = np.column_stack([features.lon, features.lat])[at[mapped]]
    free = ~named & placed
    anchor[free] = np.column_stack([records["lon"], records["lat"]])[free]
    for number, watch in watches.items():
        # The candidate may have been accepted meanwhile: then this is evidence about the map feature it became.
        feature_id[number], watch_id[number] = watch.feature_id or 0, watch.id
        candidate_id[number] = 0 if watch.feature_id else watch.candidate_id
        anchor[number] = watch.lon, watch.lat
    maps, sequences = (np.array([one[part] for one in identities if one], np.int64) for part in (0, 1))
    return Resolved(reported, maps, sequences, feature_id, watch_id, candidate_id, archived, anchor), {}


def passes_of(resolved: Resolved, chosen: Indices, ids: Ids) -> list[StoredPass]:
    """Return some of the passes one by one, with these ids."""
    reported = resolved.reported
    records = reported.records[chosen]
    begun, ended = instants(records["started_at"]), instants(records["ended_at"])
    columns = zip(
        ids.tolist(),
        reported.message[chosen].tolist(),
        reported.index[chosen].tolist(),
        reported.feature_class[chosen].tolist(),
        reported.sign[chosen].tolist(),
        reported.value[chosen].tolist(),
        resolved.feature_id[chosen].tolist(),
        resolved.watch_id[chosen].tolist(),
        resolved.candidate_id[chosen].tolist(),
        resolved.archived[chosen].tolist(),
        records[
            ["weight_for", "weight_against", "status", "flags", "lon", "lat", "cov_xx", "cov_xy", "cov_yy"]
        ].tolist(),
        begun,
        ended,
        strict=True,
    )
    texts, maps = reported.texts, resolved.map_id.tolist()
    made = []
    for key, message, index, kind, sign, value, feature, watch, candidate, archived, record, start, end in columns:
        claimed = reported.claimed[message]
        f, a, status, flags, lon, lat, xx, xy, yy = record
        made.append(
            StoredPass(
                id=key,
                key=(claimed.account_id, claimed.session_id, claimed.message_id, index),
                map_id=maps[message],
                started_at=start,
                ended_at=end,
                status=STATUSES[status],
                feature_class=texts[kind] or "",
                sign=texts[sign],
                value=texts[value],
                weight_for=f,
                weight_against=a,
                valid=bool(flags & VALID),
                trusted=reported.envelopes[message].trusted,
                feature_id=feature or None,
                watch_id=watch or None,
                candidate_id=candidate or None,
                archived=archived,
                place=(lon, lat, (xx, xy, yy)) if flags & PLACED else None,
            )
        )
    return made


def match_feature(
    item: StoredPass, map_sequence: int, nearby: Iterable[NearbyFeature], policy: Policy
) -> NearbyFeature | None:
    """Return the map feature that an unreferenced pass is about although it does not name it, or None.

    A car with an older map finds as new what has been accepted since; a third party may expect a feature without
    saying which. The nearest of the same type within the gate is meant.
    """
    place = item.place
    if place is None or not item.valid:
        return None
    possible = [
        feature
        for feature in nearby
        # the car knew this feature, and says that its find is another
        if not (item.clusters and feature.since_sequence <= map_sequence)
        and feature.feature_class == item.feature_class
        and _compatible(item, feature)
    ]
    if not possible:
        return None
    lon, lat, (xx, xy, yy) = place
    rules = policy.for_class(item.feature_class)
    frame = frame_at(lon, lat)
    origin = frame.to_local(lon, lat)
    best: tuple[float, int] | None = None
    matched: NearbyFeature | None = None
    for feature in possible:
        shift = frame.to_local(feature.lon, feature.lat) - origin
        own = feature.position_std_m**2 + rules.position_floor_m**2
        spread = np.array([[xx + own, xy], [xy, yy + own]])
        squared = float(shift @ np.linalg.solve(spread, shift))
        inside = squared <= rules.gate and float(np.hypot(*shift)) <= rules.match_radius_m
        if inside and (best is None or (squared, feature.id) < best):
            best, matched = (squared, feature.id), feature
    return matched


def within_budget(
    resolved: Resolved, reach_m: float, budget: int, extra: frozenset[Cell]
) -> tuple[Resolved, frozenset[Cell]]:
    """Return the longest prefix of messages whose cells are at most `budget`, at least one message, and the cells."""
    message, keys = resolved.keys(reach_m)
    order = np.argsort(message, kind="stable")
    distinct, first = np.unique(keys[order], return_index=True)
    new = ~np.isin(distinct, [cell.key for cell in extra])
    added = np.bincount(message[order][first[new]], minlength=resolved.messages)
    fits = len(extra) + np.cumsum(added) <= budget
    taken = max(int(np.count_nonzero(np.cumprod(fits))), 1)
    held = np.unique(keys[message < taken])
    return resolved.only(np.arange(resolved.messages) < taken), extra | frozenset(map(Cell.of_key, held.tolist()))


def _distinct(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rows (N, 3), each once."""
    ordered = table[np.lexsort(table.T[::-1])]
    return np.asarray(ordered[np.append(np.ones(1, bool), (np.diff(ordered, axis=0) != 0).any(axis=1))[: len(table)]])


def _compatible(item: StoredPass, feature: NearbyFeature) -> bool:
    return all(
        seen is None or mapped is None or seen == mapped
        for seen, mapped in ((item.sign, feature.sign), (item.value, feature.value))
    )
