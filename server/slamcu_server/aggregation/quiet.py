"""Add passes to map features of which the feed has nothing to say: nearly all of them, nearly always.

Their windows are read, folded side by side and written back, without an object for each pass that is stored. A feature
that might speak, because evidence against it gathers or because the feed knows it, is left to `refold`, which folds
from the stored passes and decides; so is one whose window may not be of all its passes. Both ways fold the same passes
by the same law.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import EPOCH_S, FoldedColumns, PassColumns, Policy, fold_columns
from slamcu_core.evidence import support
from slamcu_server.aggregation import reads, windows, writes
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.aggregation.reads import WindowedFeature
from slamcu_server.changes.transitions import may_speak

_EPOCH_US = round(EPOCH_S * 1e6)
_START = datetime(1970, 1, 1, tzinfo=UTC)
_NEVER = np.iinfo(np.int64).min

Flags = NDArray[np.bool_]
Times = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Fold:
    """What N features are folded to, and their windows."""

    state: FoldedColumns
    passes: NDArray[np.intp]  # (N,)
    looked: NDArray[np.intp]
    blocked: NDArray[np.intp]
    forgotten_looked: NDArray[np.intp]  # (N,), of the expired passes
    forgotten_blocked: NDArray[np.intp]
    last_seen: Times  # (N,), POSIX microseconds, _NEVER where there is none
    last_looked: Times
    expired_before: Times  # (N,), passes that ended before this were left out; _NEVER where none was
    unseen: Flags  # (N,), whether the last pass that saw it is among them
    windows: list[bytes]


async def append(connection: AsyncConnection, passes: Iterable[StoredPass], policy: Policy) -> frozenset[int]:
    """Fold passes just stored into the features they are about, and return the features that are left to `refold`.

    The caller holds the cells.
    """
    added: dict[int, list[StoredPass]] = {}
    for item in passes:
        if item.feature_id is not None and not item.archived:
            added.setdefault(item.feature_id, []).append(item)
    features = await reads.windowed_features(connection, {key: len(mine) for key, mine in added.items()})
    left = frozenset(feature.id for feature in features if feature.window is None or feature.said)
    by_class: dict[str, list[WindowedFeature]] = {}
    for feature in features:
        if feature.id not in left:
            by_class.setdefault(feature.feature_class, []).append(feature)
    for name in sorted(by_class):
        left |= await _append(connection, by_class[name], added, policy)
    return left


async def _append(
    connection: AsyncConnection,
    features: Sequence[WindowedFeature],
    added: dict[int, list[StoredPass]],
    policy: Policy,
) -> frozenset[int]:
    """Fold features of one class, write those that stay quiet and return the others."""
    done = await asyncio.to_thread(_fold, features, [added[feature.id] for feature in features], policy)
    rules = policy.for_class(features[0].feature_class)
    state = done.state
    loud = done.unseen | may_speak(state.weight_for, state.weight_against, state.standing, rules)
    quiet = np.flatnonzero(~loud)
    ids = [features[number].id for number in quiet.tolist()]
    await writes.upsert_feature_columns(connection, _columns(ids, done, quiet, policy.version))
    ends = zip(ids, _moments(done.expired_before[quiet]), strict=True)
    await writes.delete_passes_before(connection, {key: end for key, end in ends if end is not None})
    return frozenset(features[number].id for number in np.flatnonzero(loud).tolist())


def _fold(features: Sequence[WindowedFeature], added: Sequence[Sequence[StoredPass]], policy: Policy) -> _Fold:
    rules = policy.for_class(features[0].feature_class)
    known = [feature.window or b"" for feature in features]
    table = np.concatenate([windows.unpack(known), windows.pack(item for mine in added for item in mine)])
    counts = [len(window) // windows.RECORD.itemsize for window in known], [len(mine) for mine in added]
    numbers = np.arange(len(features))
    feature = np.concatenate([np.repeat(numbers, count) for count in counts])
    order = np.lexsort((table["ended_at"], feature))
    table, feature = table[order], feature[order]
    state = fold_columns(
        PassColumns(
            feature, table["contributor"], table["ended_at"] / 1e6, table["weight_for"], table["weight_against"]
        ),
        support([each.existence_confidence for each in features]),
        rules,
        deleted=True,
    )
    # passes of epochs before a full window are expired, as `summarize` has it
    full = state.folded == rules.window
    begin = np.full(len(features), _NEVER)
    begin[full] = np.floor(state.oldest[full] / EPOCH_S).astype(np.int64) * _EPOCH_US
    expired = table["ended_at"] < begin[feature]
    flags = table["flags"]
    looked = (flags & (windows.COUNTS | windows.BLOCKED)) == windows.COUNTS
    blocked = (flags & (windows.COUNTS | windows.BLOCKED)) == windows.COUNTS | windows.BLOCKED
    last_seen = _last(feature, table["ended_at"], looked & (flags & windows.FOUND > 0), len(features))

    def count(chosen: Flags) -> NDArray[np.intp]:
        return np.bincount(feature[chosen], minlength=len(features))

    passes, packed = count(~expired), windows.stored(table[~expired])
    ends = (windows.RECORD.itemsize * np.cumsum(passes)).tolist()
    return _Fold(
        state=state,
        passes=passes,
        looked=count(looked & ~expired),
        blocked=count(blocked & ~expired),
        forgotten_looked=count(looked & expired),
        forgotten_blocked=count(blocked & expired),
        last_seen=last_seen,
        last_looked=_last(feature, table["ended_at"], looked, len(features)),
        expired_before=np.where(count(expired) > 0, begin, _NEVER),
        unseen=(last_seen != _NEVER) & (last_seen < begin),
        windows=[packed[begin:end] for begin, end in zip([0, *ends[:-1]], ends, strict=True)],
    )


def _last(feature: NDArray[np.intp], ended_at: Times, chosen: Flags, features: int) -> Times:
    """Return (N,), the latest of the chosen times of each feature; times are in ascending order within a feature."""
    latest = np.full(features, _NEVER)
    latest[feature[chosen]] = ended_at[chosen]  # the last of each is written last
    return latest


def _columns(ids: list[int], done: _Fold, chosen: NDArray[np.intp], policy_version: str) -> dict[str, list[object]]:
    """Return the columns of the table of some of the features."""
    state = done.state
    informative = np.where(np.isnan(state.last_informative), _NEVER, np.rint(state.last_informative * 1e6))
    numbers = {
        "weight_for": state.weight_for,
        "weight_against": state.weight_against,
        "standing": state.standing,
        "contributors_for": state.contributors_for,
        "contributors_against": state.contributors_against,
        "passes": done.passes,
        "looked": done.looked,
        "blocked": done.blocked,
        "forgotten_looked": done.forgotten_looked,
        "forgotten_blocked": done.forgotten_blocked,
    }
    return {
        "feature_id": [*ids],
        **{name: column[chosen].tolist() for name, column in numbers.items()},
        "last_looked": [*_moments(done.last_looked[chosen])],
        "last_seen": [*_moments(done.last_seen[chosen])],
        "last_informative": [*_moments(informative[chosen].astype(np.int64))],
        "fades_at": [None] * len(ids),
        "policy_version": [policy_version] * len(ids),
        "passes_window": [done.windows[number] for number in chosen.tolist()],
    }


def _moments(microseconds: Times) -> list[datetime | None]:
    return [None if each == _NEVER else _START + timedelta(microseconds=each) for each in microseconds.tolist()]
