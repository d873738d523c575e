"""The SQLite file of the outbox: opened with care, locked, and its errors told in one way."""

from __future__ import annotations

import os
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slamcu_client.errors import OutboxError
from slamcu_client.outbox_schema import APPLICATION_ID, SCHEMA, SCHEMA_VERSION

_MAGIC = b"SQLite format 3\0"
_APPLICATION_ID_AT = 68  # in the header of the file
_BUSY_S = 30.0  # how long another process may hold the file


class OutboxDatabase:
    """One connection that threads share, each statement or transaction under a lock.

    Parameters
    ----------
    path : the file; made, with mode 0600, if it is not there.

    Raises OutboxError if the file cannot be opened or is not an outbox; it is then left as it was.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.RLock()
        try:
            os.close(os.open(path, os.O_RDWR | os.O_CREAT, 0o600))
            if not _is_new_or_ours(path):
                raise OutboxError(f"{path}: is there, but is not an outbox")
            # before SQLite opens it, because its companions (-wal, -shm) take over this mode
            path.chmod(0o600)
        except OSError as error:
            raise OutboxError(f"{path}: cannot be opened: {error.strerror}") from error
        with self._errors():
            self._db = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None, check_same_thread=False)
        try:
            with self._errors():
                self._prepare()
        except OutboxError:
            self._db.close()
            raise

    def _prepare(self) -> None:
        self._db.execute("PRAGMA synchronous = FULL")
        self._db.execute("PRAGMA journal_size_limit = 4194304")
        with self.transaction() as db:
            (found,) = db.execute("PRAGMA user_version").fetchone()
            (tables,) = db.execute("SELECT count(*) FROM sqlite_master").fetchone()
            if found > SCHEMA_VERSION:
                raise OutboxError(f"{self._path}: was written by a newer slamcu-client (schema {found})")
            if not tables:
                for statement in SCHEMA:
                    db.execute(statement)
                db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
                db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        # only if it is not so yet, because the change wants the file for itself
        if self._db.execute("PRAGMA journal_mode").fetchone() != ("wal",):
            self._db.execute("PRAGMA journal_mode = WAL")

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Give the connection for reading; raises OutboxError where SQLite fails."""
        with self._lock, self._errors():
            yield self._db

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Give the connection in a transaction that is on disk when the block ends, or undone if it fails."""
        with self._lock, self._errors():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                self._db.rollback()
                raise

    def close(self) -> None:
        """Close the file."""
        with self._lock, self._errors():
            self._db.close()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise OutboxError(f"{self._path}: {error}") from error


def _is_new_or_ours(path: Path) -> bool:
    """Tell whether a file is empty or an outbox, without SQLite, which would change the files of others."""
    with path.open("rb") as file:
        header = file.read(100)
    mark = header[_APPLICATION_ID_AT : _APPLICATION_ID_AT + 4]
    return not header or (header.startswith(_MAGIC) and mark == APPLICATION_ID.to_bytes(4, "big"))
