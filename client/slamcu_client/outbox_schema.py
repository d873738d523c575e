"""The tables of the outbox."""

from __future__ import annotations

from typing import Final

APPLICATION_ID: Final = 0x534C4D43  # "SLMC": tells an outbox from any other SQLite file
SCHEMA_VERSION: Final = 1

SCHEMA: Final = (
    # never emptied (a hundred bytes a session): a forgotten counter would hand out the same ids again
    """
    CREATE TABLE sessions (
        session_id TEXT PRIMARY KEY,
        last_message_id INTEGER NOT NULL,
        reported_until INTEGER,  -- microseconds since 1970
        closed INTEGER NOT NULL
    ) WITHOUT ROWID
    """,
    """
    CREATE TABLE messages (
        sequence INTEGER PRIMARY KEY AUTOINCREMENT,
        session_id TEXT NOT NULL,
        message_id INTEGER NOT NULL,
        attempts INTEGER NOT NULL DEFAULT 0,
        put_off INTEGER NOT NULL DEFAULT 0,
        body BLOB NOT NULL,
        UNIQUE (session_id, message_id)
    )
    """,
    "CREATE INDEX messages_in_turn ON messages (put_off, (attempts = 0), sequence)",
    """
    CREATE TABLE rejected (
        sequence INTEGER PRIMARY KEY AUTOINCREMENT,
        session_id TEXT NOT NULL,
        message_id INTEGER NOT NULL,
        reason TEXT NOT NULL,
        detail TEXT NOT NULL,
        rejected_at TEXT NOT NULL,
        body BLOB NOT NULL
    )
    """,
    # counted by the database itself, so that the bound costs the same however much waits, and no crash can skew it
    """
    CREATE TABLE totals (
        pending INTEGER NOT NULL,
        pending_bytes INTEGER NOT NULL,
        acknowledged INTEGER NOT NULL,
        rejected INTEGER NOT NULL,
        dropped INTEGER NOT NULL
    )
    """,
    "INSERT INTO totals VALUES (0, 0, 0, 0, 0)",
    """
    CREATE TRIGGER messages_in AFTER INSERT ON messages BEGIN
        UPDATE totals SET pending = pending + 1, pending_bytes = pending_bytes + length(new.body);
    END
    """,
    """
    CREATE TRIGGER messages_out AFTER DELETE ON messages BEGIN
        UPDATE totals SET pending = pending - 1, pending_bytes = pending_bytes - length(old.body);
    END
    """,
)
