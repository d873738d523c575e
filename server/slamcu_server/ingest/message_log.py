"""The log of messages between ingest and aggregation: what is appended once is claimed until it is marked."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Protocol

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation import log as worker_log
from slamcu_server.aggregation.boxes import PROBE
from slamcu_server.aggregation.forgetting import content_digest, ids_digest
from slamcu_server.aggregation.log import ClaimedMessage
from slamcu_server.database.statements import text


class Outcome(StrEnum):
    """What became of an entry."""

    ACCEPTED = "accepted"
    DUPLICATE = "duplicate"  # it was there already, with the same bytes
    CONFLICT = "conflicting-bytes"  # its ids were there already, with other bytes


@dataclass(frozen=True)
class LogEntry:
    """A message to append: its ids within the account, and its bytes."""

    session_id: str
    message_id: int
    body: bytes
    region: int = 0  # where it is from, for the order of work: `cells.region_at`
    condensed: bytes | None = None  # what it reports: `condensed.condense`

    @property
    def key(self) -> tuple[str, int]:
        """The ids that make it one message of its account."""
        return self.session_id, self.message_id

    @cached_property
    def sha256(self) -> bytes:
        """The hash that tells a repetition from a contradiction."""
        return hashlib.sha256(self.body).digest()


class MessageLog(Protocol):
    """A durable log that takes each message of an account once, whatever is repeated, and in whatever batches."""

    async def append(self, account_id: int, entries: Sequence[LogEntry]) -> list[Outcome]:
        """Append messages and return what became of each, in their order."""
        ...

    async def claim(self, limit: int) -> list[ClaimedMessage]:
        """Take up to `limit` messages that are pending and that nobody else holds, oldest first."""
        ...

    async def mark_fused(self, ids: Iterable[int]) -> None:
        """Say that claimed messages have had their effect."""
        ...

    async def quarantine(self, reasons: Mapping[int, str]) -> None:
        """Put claimed messages that cannot be used aside, each with its reason."""
        ...


class PostgresMessageLog:
    """The log as a table, within the transaction of `connection`: an append is durable, and a claim ends, with it."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def append(self, account_id: int, entries: Sequence[LogEntry]) -> list[Outcome]:
        """Append messages and return what became of each, in their order."""
        first: dict[tuple[str, int], LogEntry] = {}
        for entry in entries:
            first.setdefault(entry.key, entry)
        # Sorted, so that two batches with the same messages wait for each other and do not deadlock.
        unique = sorted(first.values(), key=lambda entry: entry.key)
        inserted = await self._insert(account_id, unique)
        present = {(key, first[key].sha256) for key in inserted}
        if earlier := [entry for entry in entries if entry.key not in inserted]:
            present |= await self._here(account_id, earlier)
        if inserted:
            await worker_log.call(self._connection)
        return [self._outcome(entry, first, inserted, present) for entry in entries]

    async def claim(self, limit: int) -> list[ClaimedMessage]:
        """Take up to `limit` messages that are pending and that nobody else holds, oldest first."""
        return await worker_log.claim(self._connection, limit)

    async def mark_fused(self, ids: Iterable[int]) -> None:
        """Say that claimed messages have had their effect."""
        await worker_log.mark_fused(self._connection, ids)

    async def quarantine(self, reasons: Mapping[int, str]) -> None:
        """Put claimed messages that cannot be used aside, each with its reason."""
        await worker_log.quarantine(self._connection, reasons)

    @staticmethod
    def _outcome(
        entry: LogEntry,
        first: Mapping[tuple[str, int], LogEntry],
        inserted: set[tuple[str, int]],
        present: set[tuple[tuple[str, int], bytes]],
    ) -> Outcome:
        if (entry.key, entry.sha256) not in present:
            return Outcome.CONFLICT
        return Outcome.ACCEPTED if entry.key in inserted and first[entry.key] is entry else Outcome.DUPLICATE

    async def _insert(self, account_id: int, entries: Sequence[LogEntry]) -> set[tuple[str, int]]:
        result = await self._connection.execute(
            text(f"""
            INSERT INTO messages (account_id, session_id, message_id, sha256, body, region, condensed)
            SELECT :account, new.* FROM unnest(CAST(:sessions AS text[]), CAST(:numbers AS bigint[]),
                CAST(:hashes AS bytea[]), CAST(:bodies AS bytea[]), CAST(:regions AS bigint[]),
                CAST(:condensed AS bytea[])) AS new (session_id, message_id, sha256, body, region, condensed)
            WHERE NOT EXISTS (
                SELECT FROM forgotten_messages f
                WHERE f.ids = {ids_digest(":account", "new.session_id", "new.message_id")} {PROBE})
            ON CONFLICT (account_id, session_id, message_id) DO NOTHING
            RETURNING session_id, message_id"""),  # noqa: S608  (constants)
            {
                "account": account_id,
                "sessions": [entry.session_id for entry in entries],
                "numbers": [entry.message_id for entry in entries],
                "hashes": [entry.sha256 for entry in entries],
                "bodies": [entry.body for entry in entries],
                "regions": [entry.region for entry in entries],
                "condensed": [entry.condensed for entry in entries],
            },
        )
        return {(row.session_id, row.message_id) for row in result}

    async def _here(self, account_id: int, entries: Sequence[LogEntry]) -> set[tuple[tuple[str, int], bytes]]:
        """Return the ids and hashes of those entries that are here with the same bytes, or were and are forgotten."""
        # A new statement: it sees what another transaction committed while the insert waited for it.
        result = await self._connection.execute(
            text(f"""
            SELECT asked.* FROM unnest(CAST(:sessions AS text[]), CAST(:numbers AS bigint[]), CAST(:hashes AS bytea[]))
                AS asked (session_id, message_id, sha256)
            LEFT JOIN LATERAL (
                SELECT m.sha256 FROM messages m WHERE m.account_id = :account
                AND m.session_id = asked.session_id AND m.message_id = asked.message_id {PROBE}) m ON true
            LEFT JOIN LATERAL (
                SELECT f.content FROM forgotten_messages f
                WHERE f.ids = {ids_digest(":account", "asked.session_id", "asked.message_id")} {PROBE}) f ON true
            WHERE asked.sha256 = m.sha256 OR f.content = {content_digest("asked.sha256")}"""),  # noqa: S608  (constants)
            {
                "account": account_id,
                "sessions": [entry.session_id for entry in entries],
                "numbers": [entry.message_id for entry in entries],
                "hashes": [entry.sha256 for entry in entries],
            },
        )
        return {((row.session_id, row.message_id), bytes(row.sha256)) for row in result}
