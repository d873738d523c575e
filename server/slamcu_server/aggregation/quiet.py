"""Add passes to map features of which the feed has nothing to say: nearly all of them, nearly always.

Their windows are read, folded side by side and written back, without an object for each pass that is stored. A feature
that might speak, because evidence against it gathers or because the feed knows it, is left to `refold`, which folds
from the stored passes and decides; so is one whose window may not be of all its passes. Both ways fold the same passes
by the same law.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import EPOCH_S, ClassPolicy, PassColumns, Policy, fold_columns
from slamcu_core.evidence import support
from slamcu_server.aggregation import reads, windows, writes
from slamcu_server.aggregation.binary import Column
from slamcu_server.aggregation.condensed import instants
from slamcu_server.aggregation.lookups import KnownFeatures
from slamcu_server.changes.transitions import may_speak

_EPOCH_US = round(EPOCH_S * 1e6)
_NEVER = np.iinfo(np.int64).min

Flags = NDArray[np.bool_]
Ids = NDArray[np.int64]
Times = NDArray[np.int64]
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
    features = await reads.windowed_features(connection, dict(zip(ids.tolist(), counts.tolist(), strict=True)))
    feature_class, confidence = await _kinds(connection, features.id, known_features)
    new_of = np.searchsorted(features.id, about)
    known = windows.unpack(features.windows)
    known_of = np.repeat(np.arange(len(features.id)), features.window_bytes // windows.RECORD.itemsize)
    left = features.said | ~features.known
    loud, quiet, packed = [features.id[left]], [np.zeros(0, _FOLDED)], list[bytes]()
    for name in np.unique(feature_class[~left]).tolist():
        chosen = ~left & (feature_class == name)
        number = np.cumsum(chosen) - 1
        old, new = chosen[known_of], chosen[new_of]
        folded, mine = await asyncio.to_thread(
            _fold,
            np.concatenate([known[old], entries[new]]),
            np.concatenate([number[known_of[old]], number[new_of[new]]]),
            confidence[chosen],
            policy.for_class(name),
        )
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


def _fold(
    table: windows.Records, feature: NDArray[np.intp], confidence: NDArray[np.float64], rules: ClassPolicy
) -> tuple[NDArray[np.void], list[bytes]]:
    """Fold P passes over N features of one class, each about the feature of that number; return (N,), and windows."""
    order = np.lexsort((table["ended_at"], feature))
    table, feature = table[order], feature[order]
    state = fold_columns(
        PassColumns(
            feature, table["contributor"], table["ended_at"] / 1e6, table["weight_for"], table["weight_against"]
        ),
        support(confidence),
        rules,
        deleted=True,
    )
    # passes of epochs before a full window are expired, as `summarize` has it
    full = state.folded == rules.window
    begin = np.full(len(confidence), _NEVER)
    begin[full] = np.floor(state.oldest[full] / EPOCH_S).astype(np.int64) * _EPOCH_US
    expired = table["ended_at"] < begin[feature]
    flags = table["flags"]
    looked = (flags & (windows.COUNTS | windows.BLOCKED)) == windows.COUNTS
    blocked = (flags & (windows.COUNTS | windows.BLOCKED)) == windows.COUNTS | windows.BLOCKED
    last_seen = _last(feature, table["ended_at"], looked & (flags & windows.FOUND > 0), len(confidence))

    def count(chosen: Flags) -> NDArray[np.intp]:
        return np.bincount(feature[chosen], minlength=len(confidence))

    folded = np.zeros(len(confidence), _FOLDED)
    for name in ("weight_for", "weight_against", "standing", "contributors_for", "contributors_against"):
        folded[name] = getattr(state, name)
    folded["passes"] = count(~expired)
    folded["looked"], folded["blocked"] = count(looked & ~expired), count(blocked & ~expired)
    folded["forgotten_looked"], folded["forgotten_blocked"] = count(looked & expired), count(blocked & expired)
    folded["last_seen"] = last_seen
    folded["last_looked"] = _last(feature, table["ended_at"], looked, len(confidence))
    informed = ~np.isnan(state.last_informative)
    folded["last_informative"] = _NEVER
    folded["last_informative"][informed] = np.rint(state.last_informative[informed] * 1e6)
    folded["expired_before"] = np.where(count(expired) > 0, begin, _NEVER)
    folded["speaks"] = may_speak(state.weight_for, state.weight_against, state.standing, rules)
    folded["speaks"] |= (last_seen != _NEVER) & (last_seen < begin)
    packed = windows.stored(table[~expired])
    ends = (windows.RECORD.itemsize * np.cumsum(folded["passes"])).tolist()
    return folded, [packed[begin:end] for begin, end in zip([0, *ends[:-1]], ends, strict=True)]


def _last(feature: NDArray[np.intp], ended_at: Times, chosen: Flags, features: int) -> Times:
    """Return (N,), the latest of the chosen times of each feature; times are in ascending order within a feature."""
    latest = np.full(features, _NEVER)
    latest[feature[chosen]] = ended_at[chosen]  # the last of each is written last
    return latest
