"""The message log as the worker sees it: claim, mark, put aside, and forget bodies in time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation.locks import announce, announced, turn
from slamcu_server.database.statements import text

CHANNEL = "slamcu_messages"
"""The channel on which the ingest tells that messages wait."""

FORM = 1
"""Of what the ingest condenses (`condensed`); another number whenever it changes: then the bytes are read again."""

_HORIZON = 4
"""Batches' worth of the oldest messages from which one is chosen along the map."""

_FEW = 32
"""Messages that a batch takes at least, if they wait: of fewer, what a batch costs by itself would be most."""

_COLUMNS = f"""id, account_id, session_id, message_id, region,
    CASE WHEN get_byte(condensed, 0) = {FORM} THEN condensed END AS condensed,
    CASE WHEN get_byte(condensed, 0) = {FORM} THEN NULL ELSE body END AS body"""
_CLAIM = f"SELECT {_COLUMNS} FROM messages WHERE state = 'pending' {{which}} LIMIT :limit FOR UPDATE SKIP LOCKED"  # noqa: S608


@dataclass(frozen=True, slots=True)
class ClaimedMessage:
    """A message of the log that this transaction holds."""

    id: int
    account_id: int
    session_id: str
    message_id: int
    body: bytes  # nothing if it is condensed
    region: int = 0  # where it is from: `cells.region_at`
    condensed: bytes | None = None  # what it reports, read already: `condensed.read`


async def call(connection: AsyncConnection) -> None:
    """Tell the workers, once this transaction is done, that messages wait."""
    await connection.execute(text("SELECT pg_notify(:channel, '')"), {"channel": CHANNEL})


async def share(connection: AsyncConnection, limit: int) -> int:
    """Return how many messages a batch of at most `limit` takes: half of what waits, but no fewer than a few.

    Another worker finds the other half elsewhere on the map, where a batch of everything would have held its cells.
    """
    found = await connection.execute(
        text("SELECT count(*) FROM (SELECT FROM messages WHERE state = 'pending' LIMIT :most) AS waiting"),
        {"most": 2 * limit},
    )
    return min(limit, max(_FEW, -(-int(found.scalar_one()) // 2)))


async def claim(
    connection: AsyncConnection, limit: int, ids: Sequence[int] | None = None, *, beside_others: bool = False
) -> list[ClaimedMessage]:
    """Lock up to `limit` pending messages (of `ids`, if given) that no other worker holds, and announce where they are.

    The oldest comes first, and with it those from the regions that follow its own: a batch of one part of the map
    touches few features and cells, and two workers with long backlogs keep out of each other's way. Only the oldest
    _HORIZON batches are chosen from, so that nobody waits for his region longer than these take.

    Regions that others have announced are left to them, if anything waits elsewhere: their cells are taken. The oldest
    of all comes first all the same with `beside_others`.
    """
    if ids is not None:
        return await _claim(connection, "AND id = ANY(CAST(:ids AS bigint[])) ORDER BY id", limit, ids=list(ids))
    async with turn(connection):
        claimed = await _claim_apart(connection, limit, beside_others=beside_others)
        await announce(connection, {message.region for message in claimed})
    return claimed


async def _claim_apart(connection: AsyncConnection, limit: int, *, beside_others: bool) -> list[ClaimedMessage]:
    busy = await announced(connection)
    apart = "AND region <> ALL(CAST(:busy AS bigint[]))"
    oldest = await _claim(connection, f"{apart} ORDER BY id", 1, busy=[] if beside_others else busy)
    if not oldest and busy:  # nothing waits elsewhere
        busy = []
        oldest = await _claim(connection, f"{apart} ORDER BY id", 1, busy=busy)
    if not oldest or limit == 1:
        return oldest
    near = f"""AND id = ANY(ARRAY(
            SELECT id FROM messages WHERE state = 'pending' AND id > :oldest {apart} ORDER BY id LIMIT :among))
        ORDER BY region < :region, abs(region - :region), id"""  # noqa: S608  (constants)
    parameters = {"oldest": oldest[0].id, "region": oldest[0].region, "among": _HORIZON * limit, "busy": busy}
    return [*oldest, *await _claim(connection, near, limit - 1, **parameters)]


async def _claim(connection: AsyncConnection, which: str, limit: int, **parameters: object) -> list[ClaimedMessage]:
    result = await connection.execute(text(_CLAIM.format(which=which)), {"limit": limit, **parameters})
    return [
        ClaimedMessage(
            row.id, row.account_id, row.session_id, row.message_id, row.body or b"", row.region, row.condensed
        )
        for row in result.all()
    ]


async def mark_fused(connection: AsyncConnection, ids: Iterable[int]) -> None:
    """Say that the effect of messages is part of this transaction, and forget where they were from.

    A region every ten seconds is a trajectory, and only who waits for its turn needs one.
    """
    await connection.execute(
        text("""
        UPDATE messages SET state = 'fused', processed_at = clock_timestamp(), error = NULL, condensed = NULL,
            region = 0
        WHERE id = ANY(CAST(:ids AS bigint[]))"""),
        {"ids": sorted(ids)},
    )


async def quarantine(connection: AsyncConnection, reasons: Mapping[int, str]) -> None:
    """Put messages that cannot be fused aside, each with its reason."""
    if not reasons:
        return
    await connection.execute(
        text("""
        UPDATE messages m
        SET state = 'quarantined', processed_at = clock_timestamp(), error = r.reason, condensed = NULL
        FROM unnest(CAST(:ids AS bigint[]), CAST(:reasons AS text[])) AS r(id, reason) WHERE m.id = r.id"""),
        {"ids": sorted(reasons), "reasons": [reasons[key] for key in sorted(reasons)]},
    )


async def release_quarantined(connection: AsyncConnection) -> int:
    """Let all messages that were put aside wait to be fused once more, and return how many."""
    result = await connection.execute(
        text("UPDATE messages SET state = 'pending', processed_at = NULL, error = NULL WHERE state = 'quarantined'")
    )
    return result.rowcount


async def empty_bodies(connection: AsyncConnection, retention: timedelta, limit: int) -> int:
    """Empty up to `limit` bodies of messages fused longer ago than `retention` and return how many.

    Their identity stays, so that what is sent again is still known: until no pass is kept, then as `forgetting` has it.
    """
    result = await connection.execute(
        text("""
        UPDATE messages SET body = NULL WHERE id IN (
            SELECT id FROM messages
            WHERE state = 'fused' AND body IS NOT NULL AND processed_at < now() - CAST(:retention AS interval)
            ORDER BY processed_at LIMIT :limit FOR UPDATE SKIP LOCKED)"""),
        {"retention": retention, "limit": limit},
    )
    return result.rowcount


async def forget_archived(connection: AsyncConnection, retention: timedelta, limit: int) -> int:
    """Delete up to `limit` passes, archived or taken out, that were fused longer ago than `retention`; return how many.

    Those that founded a candidate stay: vehicles may still name its watch feature.
    """
    result = await connection.execute(
        text("""
        DELETE FROM passes WHERE id IN (
            SELECT p.id FROM passes p JOIN messages m ON m.id = p.message
            WHERE (p.archived OR p.retraction_id IS NOT NULL) AND m.processed_at < now() - CAST(:retention AS interval)
              AND NOT EXISTS (SELECT FROM candidates c WHERE c.founding_pass = p.id)
            ORDER BY p.id LIMIT :limit FOR UPDATE OF p SKIP LOCKED)"""),
        {"retention": retention, "limit": limit},
    )
    return result.rowcount
