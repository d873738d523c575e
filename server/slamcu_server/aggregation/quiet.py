"""Add passes to map features of which the feed has nothing to say: nearly all of them, nearly always.

Their windows are read, folded side by side and written back, without an object for each pass that is stored. A feature
that might speak, because evidence against it gathers or because the feed knows it, is left to `refold`, which folds
from the stored passes and decides; so is one whose window may not be of all its passes. Both ways fold the same passes
by the same law.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import EPOCH_S, ClassPolicy, PassColumns, Policy, fold_columns
from slamcu_core.evidence import support
from slamcu_server.aggregation import reads, windows, writes
from slamcu_server.aggregation.binary import Column
from slamcu_server.aggregation.condensed import instants
from slamcu_server.aggregation.lookups import KnownFeatures
from slamcu_server.aggregation.windowed import windowed_features
from slamcu_server.changes.transitions import may_speak

_EPOCH_US = round(EPOCH_S * 1e6)
_NEVER = np.iinfo(np.int64).min

Flags = NDArray[np.bool_]
Ids = NDArray[np.int64]
Times = NDArray[np.int64]
Counts = NDArray[np.intp]
_AT_ONCE = 512  # features that are folded side by side: their windows stay in the processor's cache
_DTYPES = {"bigint": "i8", "float8": "f8", "boolean": "?", "integer": "i4", "timestamptz": "i8"}
_KINDS = {name: kind for name, kind in writes.FEATURE_TYPES.items() if kind in _DTYPES and name != "fades_at"}
"""The columns of beliefs that are folded here, and their types: nothing of these fades. Times are POSIX microseconds,
_NEVER where there is none; what is forgotten is of the expired passes."""

_FOLDED = np.dtype(
    [
        *((name, _DTYPES[kind]) for name, kind in _KINDS.items()),
        ("expired_before", "i8"),  # passes that ended before this were left out; _NEVER where none was
        ("speaks", "?"),  # whether something may be said of it, or the last pass that saw it is expired
    ]
)


async def append(
    connection: AsyncConnection, about: Ids, entries: windows.Records, known_features: KnownFeatures, policy: Policy
) -> frozenset[int]:
    """Fold passes just stored into the features they are about, and return the features that are left to `refold`.

    The caller holds the cells.

    Parameters
    ----------
    about : (P,) ids of map features.
    entries : (P,), the passes.
    known_features : most of these map features; what the others are is asked for.
    """
    ids, counts = np.unique(about, return_counts=True)
    features = await windowed_features(connection, dict(zip(ids.tolist(), counts.tolist(), strict=True)))
    feature_class, confidence = await _kinds(connection, features.id, known_features)
    held = _Held(
        windows.unpack(features.windows),
        features.window_bytes // windows.RECORD.itemsize,
        entries.take(np.argsort(about, kind="stable")),
        counts,
    )
    left = features.said | ~features.known | held.of_before
    loud, quiet, packed = [features.id[left]], [np.zeros(0, _FOLDED)], list[bytes]()
    for name in np.unique(feature_class[~left]).tolist():
        chosen = np.flatnonzero(~left & (feature_class == name))
        folded, mine = await asyncio.to_thread(_fold_all, held, chosen, confidence[chosen], policy.for_class(name))
        folded["feature_id"] = features.id[chosen]
        loud.append(folded["feature_id"][folded["speaks"]])
        quiet.append(folded[~folded["speaks"]])
        packed += [mine[at] for at in np.flatnonzero(~folded["speaks"]).tolist()]
    await _write(connection, np.concatenate(quiet), packed, policy.version)
    return frozenset(np.concatenate(loud).tolist())


async def _kinds(
    connection: AsyncConnection, ids: Ids, known: KnownFeatures
) -> tuple[NDArray[np.object_], NDArray[np.float64]]:
    """Return the classes of map features, and what their map says of their existence."""
    order = np.argsort(known.id)
    at = order[np.minimum(np.searchsorted(known.id, ids, sorter=order), len(order) - 1)] if len(order) else None
    there = np.zeros(len(ids), bool) if at is None else known.id[at] == ids
    feature_class, confidence = np.full(len(ids), "", object), np.zeros(len(ids))
    if at is not None:
        feature_class[there] = known.feature_class[at[there]]
        confidence[there] = known.existence_confidence[at[there]]
    asked = np.flatnonzero(~there)
    others = await reads.features(connection, ids[asked].tolist()) if len(asked) else {}
    for number in asked.tolist():
        other = others[int(ids[number])]
        feature_class[number], confidence[number] = other.feature_class, other.existence_confidence
    return feature_class, confidence


async def _write(
    connection: AsyncConnection, folded: NDArray[np.void], packed: Sequence[bytes], policy_version: str
) -> None:
    """Write features with their windows, and forget their expired passes."""
    columns = {
        name: Column(kind, folded[name], folded[name] == _NEVER if kind == "timestamptz" else None)
        for name, kind in _KINDS.items()
    }
    await writes.upsert_feature_columns(connection, columns, packed, policy_version)
    ended = folded[folded["expired_before"] != _NEVER]
    ends = zip(ended["feature_id"].tolist(), instants(ended["expired_before"]), strict=True)
    await writes.delete_passes_before(connection, dict(ends))


@dataclass(frozen=True, slots=True)
class _Held:
    """What is known about N features, and what is added: records that stand in the order of the features."""

    known: windows.Records
    known_counts: Counts  # (N,)
    added: windows.Records
    added_counts: Counts  # (N,), none is 0

    @property
    def of_before(self) -> Flags:
        """Say of each feature (N,) whether its window is of a server before, which kept less of a pass."""
        about = np.repeat(np.arange(len(self.known_counts)), self.known_counts)
        return np.bincount(about[windows.of_before(self.known)], minlength=len(self.known_counts)) > 0

    def of(self, features: Counts) -> tuple[windows.Records, Counts]:
        """Return the records of M features, given in ascending order, and the number (of M) that each is about."""
        chosen, about = list[windows.Records](), list[Counts]()
        for records, counts in ((self.known, self.known_counts), (self.added, self.added_counts)):
            number = np.repeat(np.arange(len(features)), counts[features])
            first = (np.cumsum(counts) - counts)[features]
            before = np.cumsum(counts[features]) - counts[features]
            chosen.append(records.take(np.arange(len(number)) + (first - before)[number]))
            about.append(number)
        return np.concatenate(chosen, dtype=windows.RECORD), np.concatenate(about)


def _fold_all(
    held: _Held, features: Counts, confidence: NDArray[np.float64], rules: ClassPolicy
) -> tuple[NDArray[np.void], list[bytes]]:
    """Fold features of one class; return (N,), and windows."""
    folded, packed = list[NDArray[np.void]](), list[bytes]()
    for begin in range(0, len(features), _AT_ONCE):
        piece = slice(begin, begin + _AT_ONCE)
        some, windows_of_some = _fold(*held.of(features[piece]), confidence[piece], rules)
        folded.append(some)
        packed += windows_of_some
    return np.concatenate(folded), packed


def _fold(
    table: windows.Records, feature: Counts, confidence: NDArray[np.float64], rules: ClassPolicy
) -> tuple[NDArray[np.void], list[bytes]]:
    """Fold P passes over N features of one class, each about the feature of that number; return (N,), and windows."""
    ended_at, contributor = table["ended_at"].astype(np.int64), table["contributor"].astype(np.int64)
    order = _order(feature, ended_at, contributor)
    table, feature, ended_at, contributor = table.take(order), feature[order], ended_at[order], contributor[order]
    doubtful = table["flags"] & windows.DOUBTFUL > 0
    state = fold_columns(
        PassColumns(
            feature,
            contributor,
            ended_at / 1e6,
            table["weight_for"].astype(float),
            table["weight_against"].astype(float),
            doubtful if doubtful.any() else None,
        ),
        support(confidence),
        rules,
        deleted=True,
    )
    # passes of epochs before a full window are expired, as `summarize` has it
    full = state.folded == rules.window
    begin = np.full(len(confidence), _NEVER)
    begin[full] = np.floor(state.oldest[full] / EPOCH_S).astype(np.int64) * _EPOCH_US
    expired = ended_at < begin[feature]
    flags = table["flags"].copy()
    looked = (flags & (windows.COUNTS | windows.BLOCKED)) == windows.COUNTS
    blocked = (flags & (windows.COUNTS | windows.BLOCKED)) == windows.COUNTS | windows.BLOCKED
    first = np.searchsorted(feature, np.arange(len(confidence)))  # each has a pass

    def count(chosen: Flags) -> Counts:
        return np.add.reduceat(chosen, first, dtype=np.intp)

    def last(chosen: Flags) -> Times:
        return np.maximum.reduceat(np.where(chosen, ended_at, _NEVER), first)

    last_seen = last(looked & (flags & windows.FOUND > 0))
    folded = np.zeros(len(confidence), _FOLDED)
    for name in ("weight_for", "weight_against", "standing", "contributors_for", "contributors_against"):
        folded[name] = getattr(state, name)
    folded["passes"] = count(~expired)
    folded["looked"], folded["blocked"] = count(looked & ~expired), count(blocked & ~expired)
    folded["forgotten_looked"], folded["forgotten_blocked"] = count(looked & expired), count(blocked & expired)
    folded["last_seen"], folded["last_looked"] = last_seen, last(looked)
    informed = ~np.isnan(state.last_informative)
    folded["last_informative"] = _NEVER
    folded["last_informative"][informed] = np.rint(state.last_informative[informed] * 1e6)
    folded["expired_before"] = np.where(count(expired) > 0, begin, _NEVER)
    folded["speaks"] = may_speak(state.weight_for, state.weight_against, state.standing, rules)
    folded["speaks"] |= (last_seen != _NEVER) & (last_seen < begin)
    packed = windows.stored(table.take(np.flatnonzero(~expired)))
    ends = (windows.RECORD.itemsize * np.cumsum(folded["passes"])).tolist()
    return folded, [packed[begin:end] for begin, end in zip([0, *ends[:-1]], ends, strict=True)]


def _order(feature: Counts, ended_at: Times, contributor: Ids) -> Counts:
    """Return the order of feature, time, then contributor; what is in order but for a few is soon sorted."""
    begin, end = int(ended_at.min()), int(ended_at.max()) + 1
    if (int(feature.max()) + 1) * (end - begin) < 2**63:  # not where a pass is dated to antiquity
        key = feature * (end - begin) + (ended_at - begin)
        order = np.argsort(key, kind="stable")
        if (np.diff(key[order]) != 0).all():
            return order
    return np.lexsort((contributor, ended_at, feature))
