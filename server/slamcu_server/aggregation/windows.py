"""The window of a map feature: the passes that its belief is folded from, packed into one value of its row.

A batch that adds to a feature reads one row instead of all its passes, and folds exactly what a refold of the stored
passes would: the window is a copy of them, never a sum. It names no session or message. Passes remain the source:
whatever changes them otherwise (a review, a retraction, a rebuild) folds from them and packs the window anew.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np
from numpy.typing import NDArray

from slamcu_core.sensoris.times import to_microseconds
from slamcu_server.aggregation.condensed import STATUSES, VALID
from slamcu_server.aggregation.passes import BLOCKED_STATUS, FOUND_STATUSES, StoredPass
from slamcu_server.aggregation.resolve import Resolved

RECORD = np.dtype(
    [
        ("ended_at", ">i8"),  # POSIX microseconds
        ("contributor", ">i8"),
        ("weight_for", ">f8"),
        ("weight_against", ">f8"),
        ("flags", "u1"),
    ]
)
"""One pass: 33 bytes, of which a full window of 64 takes 2 kB. Stored as PostgreSQL's int8send and float8send do it."""

COUNTS, BLOCKED, FOUND, DOUBTFUL, CROSSED_OUT = 1, 2, 4, 8, 16
_BLOCKED = np.array([status is BLOCKED_STATUS for status in STATUSES])
_FOUND = np.array([status in FOUND_STATUSES for status in STATUSES])

Records = NDArray[np.void]
Flags = NDArray[np.bool_]


def pack(passes: Iterable[StoredPass]) -> Records:
    """Return passes as records, in the order given."""
    return np.array([_record(item) for item in passes], RECORD)


def of_columns(resolved: Resolved, chosen: NDArray[np.intp]) -> Records:
    """Return passes that were just resolved as records."""
    reported = resolved.reported
    records, message = reported.records[chosen], reported.message[chosen]
    trusted = np.array([one.trusted for one in reported.envelopes], bool)[message]
    valid = records["flags"] & VALID > 0
    blocked, found = _BLOCKED[records["status"]], _FOUND[records["status"]]
    made = np.empty(len(chosen), RECORD)
    made["ended_at"] = records["ended_at"]
    made["contributor"] = np.array([one.account_id for one in reported.claimed], np.int64)[message]
    for name in ("weight_for", "weight_against"):
        made[name] = np.where(valid & ~blocked, records[name], 0.0)
    counts = COUNTS * (valid & trusted) | DOUBTFUL * ~trusted | CROSSED_OUT * ~valid
    made["flags"] = counts | BLOCKED * blocked | FOUND * found
    return made


def of_kept(passes: Iterable[StoredPass], expired: Collection[int]) -> bytes:
    """Return the window of one feature out of its stored passes, all but those whose ids are expired."""
    gone = frozenset(expired)
    return stored(pack(item for item in passes if item.id not in gone))


def stored(entries: Records) -> bytes:
    """Return the window of one feature: its records, in any order."""
    return entries.tobytes()


def unpack(windows: bytes) -> Records:
    """Return the records of windows that stand one after the other."""
    return np.frombuffer(windows, RECORD)


def of_before(entries: Records) -> Flags:
    """Say of records (P,) which ones a server packed that did not know doubt: they neither count nor say why."""
    return np.asarray(entries["flags"] & (COUNTS | DOUBTFUL | CROSSED_OUT) == 0)


def _record(item: StoredPass) -> tuple[int, int, float, float, int]:
    flags = COUNTS * item.counts | DOUBTFUL * (not item.trusted) | CROSSED_OUT * (not item.valid)
    flags |= BLOCKED * item.blocked | FOUND * item.found
    return to_microseconds(item.ended_at), item.contributor, *item.weights, flags
