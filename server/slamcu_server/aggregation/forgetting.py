"""What is left of a message in the end: two digests, by which a repetition of it is still known.

A message that no pass is kept of any more, and whose body is emptied, would only go on saying that an account drove in
some session at some time. It is replaced by a digest of its ids and one of its bytes, under a key of this database.
The log asks for them when it takes messages (`slamcu_server.ingest.message_log`).
"""

from __future__ import annotations

import logging
from datetime import timedelta

from sqlalchemy.exc import DBAPIError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_server.database.statements import text

logger = logging.getLogger(__name__)

_SLICE = 1000  # messages that one transaction looks at
_SLICES = 500  # of a sweep
_PAUSE = timedelta(hours=1)  # between sweeps
_NO_LOCK = "55P03"

_KEY = "(SELECT key FROM forgetting)"


def ids_digest(account: str, session: str, number: str) -> str:
    """Return the SQL expression for the digest of a message's ids, given those for the ids."""
    ids = f"int8send(CAST({account} AS bigint)) || int8send({number}) || convert_to({session}, 'UTF8')"
    return f"substr(sha256({_KEY} || {ids}), 1, 16)"


def content_digest(sha256: str) -> str:
    """Return the SQL expression for the digest of a message's bytes, given that for their SHA-256."""
    return f"substr(sha256({_KEY} || {sha256}), 1, 16)"


_TAKE_TURN = text("""
    SELECT swept_to FROM forgetting WHERE swept_at <= now() - CAST(:pause AS interval) FOR UPDATE SKIP LOCKED""")
_DUE = """m.state = 'fused' AND m.body IS NULL AND m.processed_at < now() - CAST(:retention AS interval)
    AND NOT EXISTS (SELECT FROM passes p WHERE p.message = m.id)"""
_LOOK = text(f"""
    SELECT max(id) AS last, count(*) AS messages, count(*) FILTER (WHERE due) AS due, bool_or(old) AS old FROM (
        SELECT m.id, m.processed_at < now() - CAST(:retention AS interval) AS old, {_DUE} AS due
        FROM messages m WHERE m.id > :after ORDER BY m.id LIMIT :limit) looked""")  # noqa: S608  (constants)
_FORGET = text(f"""
    WITH due AS (
        SELECT m.id, {ids_digest("m.account_id", "m.session_id", "m.message_id")} AS ids,
            {content_digest("m.sha256")} AS content
        FROM messages m WHERE m.id > :after AND m.id <= :last AND {_DUE}
    ), gone AS (
        DELETE FROM messages USING due WHERE messages.id = due.id RETURNING due.ids, due.content
    )
    INSERT INTO forgotten_messages (ids, content) SELECT ids, content FROM gone""")  # noqa: S608  (constants)


async def forget_messages(engine: AsyncEngine, retention: timedelta, *, pause: timedelta = _PAUSE) -> int:
    """Reduce what is left of messages fused longer ago than `retention`, and return how many.

    Whoever comes first within `pause` goes on with the sweep over the messages where the one before has stopped.
    """
    async with engine.begin() as connection:
        swept_to = (await connection.execute(_TAKE_TURN, {"pause": pause})).scalar_one_or_none()
        if swept_to is None:  # another's turn, or none's yet
            return 0
        await connection.execute(text("UPDATE forgetting SET swept_at = now()"))
    forgotten = 0
    try:
        for _ in range(_SLICES):
            async with engine.begin() as connection:
                swept_to, count = await _forget_slice(connection, swept_to, retention)
            forgotten += count
            if swept_to == 0:  # what follows is too new: the next sweep begins anew
                break
    except DBAPIError as error:
        if getattr(error.orig, "sqlstate", None) != _NO_LOCK:
            raise
        logger.info("messages are forgotten later: the table is in use, as by a backup")
    return forgotten


async def _forget_slice(connection: AsyncConnection, after: int, retention: timedelta) -> tuple[int, int]:
    """Forget what is due of the next messages; return after which to go on, and how many it were."""
    parameters = {"after": after, "retention": retention}
    found = (await connection.execute(_LOOK, {**parameters, "limit": _SLICE})).one()
    if found.due:
        # A message that is being taken right now, and was asked for before it is forgotten, must not find neither: all
        # who ask are let finish first, and all others wait for this slice.
        await connection.execute(text("SET LOCAL lock_timeout = '200ms'"))
        await connection.execute(text("LOCK TABLE forgotten_messages IN ACCESS EXCLUSIVE MODE"))
        await connection.execute(_FORGET, {**parameters, "last": found.last})
    swept_to = found.last if found.old and found.messages == _SLICE else 0
    await connection.execute(text("UPDATE forgetting SET swept_to = :to"), {"to": swept_to})
    return swept_to, found.due
