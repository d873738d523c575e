"""Take a batch message by message: read, check against the maps, and log once."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from google.protobuf.message import DecodeError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.errors import WireError
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import BatchItem, WireLimits, decode_batch
from slamcu_core.sensoris.proto import data_pb2
from slamcu_server.accounts.schemas import MapScope, Principal
from slamcu_server.aggregation.cells import region_at
from slamcu_server.aggregation.condensed import condense
from slamcu_server.ingest import repository
from slamcu_server.ingest.message_log import LogEntry, MessageLog, Outcome, PostgresMessageLog
from slamcu_server.ingest.plausibility import implausible
from slamcu_server.ingest.quota import PASS_BYTES
from slamcu_server.ingest.schemas import IngestResult, Rejection
from slamcu_server.problems import Problem
from slamcu_server.settings import Settings

_TEXT_SHOWN = 200


@dataclass(frozen=True, slots=True)
class _Readable:
    """A message that could be read, and where it stood in the batch."""

    index: int
    body: bytes
    report: ReportMessage
    condensed: bytes


@dataclass(frozen=True, slots=True)
class Batch:
    """The messages of a body, in its order, and those of them that could be read."""

    items: list[BatchItem]
    readable: list[_Readable]

    @property
    def passes(self) -> int:
        """What reading it cost: one a message and one a pass, or as many as an unreadable message could have held."""
        unread = sum(len(item.body) // PASS_BYTES for item in self.items if item.report is None)
        return len(self.items) + unread + sum(len(one.report.passes) for one in self.readable)


async def read(settings: Settings, body: bytes, *, is_json: bool) -> Batch:
    """Read a body's messages.

    Raises Problem 400 if the body as a whole cannot be read, and 413 if it holds too many messages.
    """
    limits = WireLimits(
        max_messages=settings.max_messages_per_batch,
        latest=datetime.now(UTC) + timedelta(seconds=settings.max_clock_ahead_s),
    )
    try:
        # In a thread: a large batch takes long enough to make other requests wait.
        return await asyncio.to_thread(_read, body, limits, is_json=is_json)
    except WireError as error:
        status = 413 if error.reason == "too-many-messages" else 400
        raise Problem(status, error.reason, error.message) from error


async def ingest(engine: AsyncEngine, reporter: Principal, batch: Batch) -> IngestResult:
    """Log the good messages of a batch durably, and return what became of each."""
    items, readable = batch.items, batch.readable
    rejected = [_unreadable(index, item) for index, item in enumerate(items) if item.report is None]
    accepted = duplicates = 0
    impossible = [
        _rejection(one, "too-many-finds", detail) for one in readable if (detail := implausible(one.report)) is not None
    ]
    refused = {rejection.index for rejection in impossible}
    possible = [one for one in readable if one.index not in refused]
    if readable:
        # Only now: a slow sender must not hold a connection. The commit comes before the answer.
        async with engine.begin() as connection:
            unknown = [*impossible, *await _refuse_unknown(connection, reporter.scope, possible)]
            refused = {rejection.index for rejection in unknown}
            kept = [message for message in readable if message.index not in refused]
            outcomes = await _log(PostgresMessageLog(connection), reporter.account_id, kept) if kept else []
        rejected += unknown
        rejected += [
            _rejection(message, Outcome.CONFLICT, "these ids were used before for a message with other bytes")
            for message, outcome in zip(kept, outcomes, strict=True)
            if outcome is Outcome.CONFLICT
        ]
        accepted, duplicates = outcomes.count(Outcome.ACCEPTED), outcomes.count(Outcome.DUPLICATE)
    return IngestResult(
        accepted=accepted, duplicates=duplicates, rejected=sorted(rejected, key=lambda rejection: rejection.index)
    )


def _read(body: bytes, limits: WireLimits, *, is_json: bool) -> Batch:
    items = decode_batch(body, is_json=is_json, limits=limits)
    readable = [
        _Readable(index, item.body, item.report, condense(item.report))
        for index, item in enumerate(items)
        if item.report is not None
    ]
    return Batch(items, readable)


async def _log(log: MessageLog, account_id: int, messages: Sequence[_Readable]) -> list[Outcome]:
    entries = [
        LogEntry(one.report.session_id, one.report.message_id, one.body, _region(one.report), one.condensed)
        for one in messages
    ]
    return await log.append(account_id, entries)


def _region(report: ReportMessage) -> int:
    """Return where a message is from: the first place that it tells; 0 if it tells none."""
    places = (one.position for one in report.passes if one.position is not None)
    return next((region_at(place.lon, place.lat) for place in places), 0)


async def _refuse_unknown(
    connection: AsyncConnection, scope: MapScope, messages: Sequence[_Readable]
) -> list[Rejection]:
    """Return rejections of the messages that name a map, version or feature that has never been in the scope."""
    map_ids, versions = await repository.find_maps(connection, scope, {one.report.map_identity for one in messages})
    named: set[tuple[bool, int, int]] = {
        (reference.watched, map_ids[one.report.map_identity.source], reference.object_id)
        for one in messages
        if one.report.map_identity.source in map_ids
        for report in one.report.passes
        if (reference := report.reference) is not None
    }
    features = {(m, o) for watched, m, o in named if not watched}
    watches = {(m, o) for watched, m, o in named if watched}
    missing = {(False, *key) for key in await repository.missing_features(connection, features)}
    missing |= {(True, *key) for key in watches - await repository.find_watches(connection, watches)}
    rejections = []
    for one in messages:
        identity = one.report.map_identity
        if identity.source not in map_ids:
            detail = f"there is no map {identity.source!r} here; GET /v1/maps names those there are"
            rejections.append(_rejection(one, "unknown-map", detail))
        elif identity not in versions:
            detail = f"map {identity.source!r} has no version {identity.version!r}"
            rejections.append(_rejection(one, "unknown-map-version", detail))
        else:
            for index, report in enumerate(one.report.passes):
                reference = report.reference
                key = reference and (reference.watched, map_ids[identity.source], reference.object_id)
                if reference is not None and key in missing:
                    kind = "watch feature" if reference.watched else "feature"
                    detail = f"passes[{index}]: map {identity.source!r} never had a {kind} {reference.object_id}"
                    rejections.append(_rejection(one, "unknown-feature", detail))
                    break
    return rejections


def _rejection(message: _Readable, reason: str, detail: str) -> Rejection:
    report = message.report
    return Rejection(
        index=message.index, session_id=report.session_id, message_id=report.message_id, reason=reason, detail=detail
    )


def _unreadable(index: int, item: BatchItem) -> Rejection:
    """Name what could not be read, by its ids if at least these could."""
    assert item.error is not None  # noqa: S101  (an item has a report or an error)
    try:
        ids = data_pb2.DataMessage.FromString(item.body).envelope.ids
    except DecodeError:
        ids = data_pb2.DataMessage().envelope.ids
    return Rejection(
        index=index,
        session_id=ids.session_id.value[:_TEXT_SHOWN] or None,
        message_id=ids.message_id.value or None,
        reason=item.error.reason,
        detail=item.error.message,
    )
