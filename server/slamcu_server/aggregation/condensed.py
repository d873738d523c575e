"""What messages report, as columns: read once at the door, and by the worker without an object for each pass.

The ingest reads every message to the end, or it could not refuse it. What it has read goes into the log beside the
bytes that were sent, in a form that a worker takes up as arrays. It lives until the message is fused; a message without
it (an older server has logged it, or it was put aside) is read from its bytes and gives the same.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamcu_core.errors import SlamcuError
from slamcu_core.reports import DetectionStatus, PassReport, ReportMessage
from slamcu_core.sensoris import decode_message
from slamcu_core.sensoris.times import EPOCH, to_microseconds
from slamcu_server.aggregation.log import FORM, ClaimedMessage

RECORD = np.dtype(
    [
        ("started_at", "<i8"),  # POSIX microseconds
        ("ended_at", "<i8"),
        ("weight_for", "<f8"),
        ("weight_against", "<f8"),
        ("lon", "<f8"),  # degrees, 0 as the covariance where it has no place
        ("lat", "<f8"),
        ("cov_xx", "<f8"),  # m²
        ("cov_xy", "<f8"),
        ("cov_yy", "<f8"),
        ("object_id", "<i8"),  # of the map feature or watch feature that it names
        ("frames_detected", "<i4"),
        ("frames_missed", "<i4"),
        ("frames_blocked", "<i4"),
        ("feature_class", "<u2"),  # number of a text of the message
        ("sign", "<u2"),  # the same, 0 for none
        ("value", "<u2"),
        ("status", "u1"),  # number in STATUSES
        ("flags", "u1"),
    ]
)
"""One pass, 100 bytes."""

VALID, NAMES, WATCHED, PLACED = 1, 2, 4, 8
STATUSES = tuple(DetectionStatus)

_HEAD = struct.Struct("<BI")
_NOWHERE = 0.0, 0.0, 0.0, 0.0, 0.0

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Envelope:
    """What a message says of all its passes."""

    source: str  # of the map
    version: str
    sensor_model: str
    software_version: str
    fleet_id: str
    trusted: bool


@dataclass(frozen=True, slots=True)
class Reported:
    """P passes of M messages."""

    claimed: tuple[ClaimedMessage, ...]  # (M,)
    envelopes: tuple[Envelope, ...]  # (M,)
    message: Indices  # (P,), which message
    index: Indices  # (P,), which pass of it
    records: NDArray[np.void]  # (P,), of RECORD, but for the texts
    feature_class: Indices  # (P,), numbers in `texts`
    sign: Indices
    value: Indices
    texts: tuple[str | None, ...]  # the first is None

    def has(self, flag: int) -> NDArray[np.bool_]:
        """Return (P,), whether a flag is set."""
        return np.asarray(self.records["flags"] & flag > 0)

    def of_messages(self, values: ArrayLike, kind: type) -> NDArray[Any]:
        """Return (P,), for each pass what is given for each message."""
        return np.array(values, kind)[self.message]

    def without(self, messages: Sequence[int]) -> Reported:
        """Return all but some messages, given by their numbers."""
        kept = np.ones(len(self.claimed), bool)
        kept[list(messages)] = False
        passes, number = kept[self.message], np.cumsum(kept) - 1
        return Reported(
            tuple(one for one, stays in zip(self.claimed, kept.tolist(), strict=True) if stays),
            tuple(one for one, stays in zip(self.envelopes, kept.tolist(), strict=True) if stays),
            number[self.message[passes]],
            self.index[passes],
            self.records[passes],
            self.feature_class[passes],
            self.sign[passes],
            self.value[passes],
            self.texts,
        )


def condense(report: ReportMessage) -> bytes:
    """Return what a message reports in the form that `read` takes up."""
    numbers: dict[str | None, int] = {None: 0}
    records = np.array([_record(item, numbers) for item in report.passes], RECORD)
    identity = report.map_identity
    envelope = [
        identity.source, identity.version, report.sensor_model, report.software_version, report.fleet_id,
        report.health.trusted,
    ]  # fmt: skip
    head = json.dumps([envelope, list(numbers)[1:]], ensure_ascii=False, separators=(",", ":")).encode()
    return _HEAD.pack(FORM, len(head)) + head + records.tobytes()


def read(claimed: Sequence[ClaimedMessage]) -> tuple[Reported, dict[int, str]]:
    """Read messages, and say by their ids why some cannot be read."""
    reasons: dict[int, str] = {}
    messages, envelopes = list[ClaimedMessage](), list[Envelope]()
    texts: dict[str | None, int] = {None: 0}
    parts, counts = list[bytes](), list[int]()
    translation, first = list[int](), list[int]()  # from the texts of each message to those of all, one after the other
    for message in claimed:
        try:
            form = _condensed(message)
        except SlamcuError as error:
            reasons[message.id] = str(error)
            continue
        _, length = _HEAD.unpack_from(form)
        begin = _HEAD.size + length
        envelope, names = json.loads(form[_HEAD.size : begin])
        messages.append(message)
        envelopes.append(Envelope(*envelope))
        first.append(len(translation))
        translation.append(0)
        translation += [texts.setdefault(name, len(texts)) for name in names]
        parts.append(form[begin:])
        counts.append((len(form) - begin) // RECORD.itemsize)
    records = np.frombuffer(b"".join(parts), RECORD)
    message_of = np.repeat(np.arange(len(messages)), counts)
    begins = np.cumsum(counts, dtype=np.intp) - counts
    of_text = np.array(translation, np.intp)
    offset = np.array(first, np.intp)[message_of]

    def named(field: str) -> Indices:
        return of_text[offset + records[field]] if len(records) else np.zeros(0, np.intp)

    reported = Reported(
        tuple(messages),
        tuple(envelopes),
        message_of,
        np.arange(len(records)) - begins[message_of],
        records,
        named("feature_class"),
        named("sign"),
        named("value"),
        tuple(texts),
    )
    return reported, reasons


def instants(microseconds: NDArray[np.int64]) -> list[datetime]:
    """Return POSIX microseconds as aware datetimes."""
    return [EPOCH + timedelta(microseconds=each) for each in microseconds.tolist()]


def _condensed(message: ClaimedMessage) -> bytes:
    """Return a message's condensed form, out of its bytes if need be. Raises SlamcuError if they cannot be read."""
    return condense(decode_message(message.body)) if message.condensed is None else message.condensed


def _record(item: PassReport, numbers: dict[str | None, int]) -> tuple[float, ...]:
    flags = VALID * item.valid
    reference, place = item.reference, item.position
    if reference is not None:
        flags |= NAMES | WATCHED * reference.watched
    if place is not None:
        flags |= PLACED
    return (
        to_microseconds(item.started_at),
        to_microseconds(item.ended_at),
        item.weight_for,
        item.weight_against,
        *(_NOWHERE if place is None else (place.lon, place.lat, *place.covariance_m2)),
        0 if reference is None else reference.object_id,
        item.frames_detected,
        item.frames_missed,
        item.frames_blocked,
        numbers.setdefault(item.feature_class, len(numbers)),
        numbers.setdefault(item.sign, len(numbers)),
        numbers.setdefault(item.value, len(numbers)),
        STATUSES.index(item.status),
        flags,
    )
