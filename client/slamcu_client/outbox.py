"""The outbox: messages wait here, on disk, until the server has acknowledged them."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from slamcu_client.errors import OutboxError, SessionClosedError
from slamcu_client.outbox_database import OutboxDatabase
from slamcu_core.sensoris.times import from_microseconds, to_microseconds

Encode = Callable[[int], bytes]
"""Turns a message id into the bytes of the message that carries it."""


class MessageKey(NamedTuple):
    """What makes a message one and the same for the server, besides the vehicle's key."""

    session_id: str
    message_id: int


@dataclass(frozen=True, slots=True)
class OutboxMessage:
    """A message that waits: one serialized SENSORIS DataMessage."""

    key: MessageKey
    body: bytes
    attempts: int = 0  # how often it was sent without a usable answer


@dataclass(frozen=True, slots=True)
class RejectedMessage:
    """A message that the server does not want, and why."""

    key: MessageKey
    body: bytes
    reason: str
    detail: str
    rejected_at: datetime


@dataclass(frozen=True, slots=True)
class SessionState:
    """How far a session has come: what a restart continues from."""

    last_message_id: int = 0
    reported_until: datetime | None = None  # every pass that ended by then is in a message
    closed: bool = False


@dataclass(frozen=True, slots=True)
class OutboxStats:
    """How full the outbox is, and what became of everything that was ever put in."""

    pending: int
    pending_bytes: int
    acknowledged: int
    rejected: int
    dropped: int  # pushed out, oldest first, because the outbox was full


class Outbox:
    """Keep messages on disk until the server has them: durable, bounded, one file.

    What `put` has stored survives a crash of the program and of the machine (write-ahead log, synchronous FULL: a car
    loses its power often, and one fsync in ten seconds is cheap). When the outbox is full the oldest messages make
    room, and `stats().dropped` counts them. Threads may share an outbox; processes may share the file.

    ::

        with Outbox("vehicle.outbox") as outbox, VehicleSession(hd_map, header, outbox) as session:
            ...
        print(outbox.stats().pending)

    Parameters
    ----------
    path : the file; made, with mode 0600, if it is not there.
    max_messages, max_bytes : bounds on what waits.
    max_rejected : how many refused messages are kept for diagnosis, the newest.

    Raises OutboxError if the file cannot be used, and later if the disk is full or broken.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        max_messages: int = 100_000,
        max_bytes: int = 256 * 2**20,
        max_rejected: int = 200,
    ) -> None:
        if min(max_messages, max_bytes, max_rejected) < 1:
            raise OutboxError("the bounds of an outbox must be at least 1")
        self.path = Path(path)
        self._max_messages, self._max_bytes, self._max_rejected = max_messages, max_bytes, max_rejected
        self._database = OutboxDatabase(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; what waits stays in it."""
        self._database.close()

    # --- what a session needs ---------------------------------------------------------------------------------------

    def session(self, session_id: str) -> SessionState:
        """Return how far a session has come; all zero for one that was never seen."""
        with self._database.reading() as db:
            row = db.execute(
                "SELECT last_message_id, reported_until, closed FROM sessions WHERE session_id = ?", (session_id,)
            ).fetchone()
        if row is None:
            return SessionState()
        until = None if row[1] is None else from_microseconds(row[1])
        return SessionState(row[0], until, bool(row[2]))

    def put(
        self,
        session_id: str,
        encoders: Sequence[Encode],
        *,
        reported_until: datetime | None = None,
        closes: bool = False,
    ) -> list[int]:
        """Store messages of one session under its next ids, all of them or none, and return the ids.

        The ids come from a counter in the same transaction, so that no crash can give one id to two different bodies.

        Parameters
        ----------
        session_id : the session.
        encoders : called with its message id each, in order.
        reported_until : aware; every pass that ended by then is now in a message.
        closes : whether this is the end of the session.

        Raises OutboxError if the disk fails or a message is larger than the outbox, SessionClosedError if the session
        is closed already.
        """
        with self._database.transaction() as db:
            state = self.session(session_id)
            if state.closed:
                raise SessionClosedError(f"session {session_id} is closed: a new drive needs a new session id")
            ids = list(range(state.last_message_id + 1, state.last_message_id + 1 + len(encoders)))
            bodies = [encode(message_id) for encode, message_id in zip(encoders, ids, strict=True)]
            if any(len(body) > self._max_bytes for body in bodies):
                raise OutboxError(f"{self.path}: a message is larger than the whole outbox ({self._max_bytes} bytes)")
            until = None if reported_until is None else to_microseconds(reported_until)
            db.execute(
                "INSERT INTO sessions (session_id, last_message_id, reported_until, closed) VALUES (?, ?, ?, ?)"
                " ON CONFLICT (session_id) DO UPDATE SET last_message_id = excluded.last_message_id,"
                " reported_until = coalesce(excluded.reported_until, reported_until), closed = excluded.closed",
                (session_id, state.last_message_id + len(ids), until, int(closes)),
            )
            db.executemany(
                "INSERT INTO messages (session_id, message_id, body) VALUES (?, ?, ?)",
                [(session_id, message_id, body) for message_id, body in zip(ids, bodies, strict=True)],
            )
            self._make_room(db)
        return ids

    def _make_room(self, db: sqlite3.Connection) -> None:
        dropped = 0
        while True:
            count, size = db.execute("SELECT pending, pending_bytes FROM totals").fetchone()
            if count <= self._max_messages and size <= self._max_bytes:
                break
            db.execute("DELETE FROM messages WHERE sequence = (SELECT min(sequence) FROM messages)")
            dropped += 1
        if dropped:
            db.execute("UPDATE totals SET dropped = dropped + ?", (dropped,))

    # --- what an uploader needs -------------------------------------------------------------------------------------

    def pending(self, limit: int = 100, max_bytes: int | None = None) -> list[OutboxMessage]:
        """Return the messages to send next: interrupted ones first, then the oldest, put-off ones last.

        At most `limit` of them and, from the second on, at most `max_bytes` together.
        """
        chosen: list[OutboxMessage] = []
        size = 0
        query = (
            "SELECT session_id, message_id, body, attempts FROM messages"
            " ORDER BY put_off, (attempts = 0), sequence LIMIT ?"
        )
        with self._database.reading() as db, closing(db.execute(query, (limit,))) as rows:
            for session_id, message_id, body, attempts in rows:
                size += len(body)
                if chosen and max_bytes is not None and size > max_bytes:
                    break
                chosen.append(OutboxMessage(MessageKey(session_id, message_id), body, attempts))
        return chosen

    def attempt(self, keys: Iterable[MessageKey]) -> None:
        """Note that messages are about to be sent, so that a crash in between leaves them marked as interrupted."""
        with self._database.transaction() as db:
            db.executemany(
                "UPDATE messages SET attempts = attempts + 1 WHERE session_id = ? AND message_id = ?", list(keys)
            )

    def put_off(self, key: MessageKey) -> None:
        """Let all others go before a message that the server fails over."""
        with self._database.transaction() as db:
            db.execute("UPDATE messages SET put_off = put_off + 1 WHERE session_id = ? AND message_id = ?", key)

    def settle(self, acknowledged: Iterable[MessageKey], rejected: Iterable[tuple[MessageKey, str, str]] = ()) -> None:
        """Act on what one answer speaks of, all of it or nothing.

        Parameters
        ----------
        acknowledged : messages that the server has taken: they are forgotten.
        rejected : messages that it refused, each with reason and detail: they move to the table of rejected ones, which
            keeps the newest few. Keys that are no longer there are passed over.
        """
        with self._database.transaction() as db:
            done = sum(_delete(db, key) for key in acknowledged)
            db.execute("UPDATE totals SET acknowledged = acknowledged + ?", (done,))
            for key, reason, detail in rejected:
                self._reject(db, key, reason, detail)

    def _reject(self, db: sqlite3.Connection, key: MessageKey, reason: str, detail: str) -> None:
        db.execute(
            "INSERT INTO rejected (session_id, message_id, body, reason, detail, rejected_at)"
            " SELECT session_id, message_id, body, ?, ?, ? FROM messages WHERE session_id = ? AND message_id = ?",
            (reason, detail, datetime.now(UTC).isoformat(), *key),
        )
        db.execute("UPDATE totals SET rejected = rejected + ?", (_delete(db, key),))
        db.execute(
            "DELETE FROM rejected WHERE sequence <= (SELECT max(sequence) FROM rejected) - ?", (self._max_rejected,)
        )

    # --- what people need -------------------------------------------------------------------------------------------

    def rejected(self, limit: int = 100) -> list[RejectedMessage]:
        """Return the newest messages that the server refused, with its reasons."""
        with self._database.reading() as db:
            rows = db.execute(
                "SELECT session_id, message_id, body, reason, detail, rejected_at FROM rejected"
                " ORDER BY sequence DESC LIMIT ?",
                (limit,),
            ).fetchall()
        return [
            RejectedMessage(MessageKey(session_id, message_id), body, reason, detail, datetime.fromisoformat(at))
            for session_id, message_id, body, reason, detail, at in rows
        ]

    def stats(self) -> OutboxStats:
        """Return how full the outbox is and what became of everything that was put in."""
        with self._database.reading() as db:
            row = db.execute("SELECT pending, pending_bytes, acknowledged, rejected, dropped FROM totals").fetchone()
        return OutboxStats(*row)


def _delete(db: sqlite3.Connection, key: MessageKey) -> int:
    return db.execute("DELETE FROM messages WHERE session_id = ? AND message_id = ?", key).rowcount
