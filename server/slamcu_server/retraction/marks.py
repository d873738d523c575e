"""Which passes are taken out, and by what: a mark on each, set when it is stored and whenever retractions change.

A pass is taken out as long as any active retraction names it; the mark is the oldest of those. A retraction is made,
and undone, while no batch is at work (`hold_alone`), and every batch holds the set of retractions as it is
(`hold`). So a pass is either stored before, and found by the retraction, or marked when it is stored.
"""

from __future__ import annotations

from collections.abc import Iterable

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.database.statements import text

ACTIVE = "('requested', 'applying', 'applied')"
"""The states, in SQL, in which a retraction holds."""

_LOCK = 2  # the keys of maps and cells begin at 2³¹

# A condition with OR would try every retraction on every pass; most name one contributor, and these have an index.
_NAMES = f"""
    state IN {ACTIVE}
    AND (session_id IS NULL OR session_id = m.session_id)
    AND (fleet_id IS NULL OR fleet_id = p.fleet_id)
    AND (software_version IS NULL OR software_version = p.software_version)
    AND (event_from IS NULL OR p.ended_at >= event_from)
    AND (event_until IS NULL OR p.ended_at < event_until)"""
_MARK = text(f"""
    UPDATE passes p SET retraction_id = now_out.retraction_id,
        candidate_id = CASE WHEN now_out.retraction_id IS NULL OR p.archived THEN p.candidate_id END
    FROM (
        SELECT p.id, min(r.id) AS retraction_id
        FROM passes p JOIN messages m ON m.id = p.message LEFT JOIN LATERAL (
            SELECT id FROM retractions WHERE contributor_id = p.contributor_id AND {_NAMES}
            UNION ALL SELECT id FROM retractions WHERE contributor_id IS NULL AND {_NAMES}
        ) r ON true
        WHERE p.id = ANY(CAST(:ids AS bigint[])) GROUP BY p.id
    ) now_out
    WHERE p.id = now_out.id AND p.retraction_id IS DISTINCT FROM now_out.retraction_id
    RETURNING p.id""")  # noqa: S608  (constants)


async def hold(connection: AsyncConnection) -> bool:
    """Hold the set of retractions until the transaction ends, and return whether any is active.

    To be called before any other lock is waited for: who makes a retraction waits for all who hold, and all who come
    later wait for him.
    """
    await connection.execute(text("SELECT pg_advisory_xact_lock_shared(:key)"), {"key": _LOCK})
    # A new statement: it sees what was committed while we waited.
    query = text(f"SELECT EXISTS (SELECT FROM retractions WHERE state IN {ACTIVE})")  # noqa: S608  (a constant)
    return bool((await connection.execute(query)).scalar_one())


async def hold_alone(connection: AsyncConnection) -> None:
    """Hold the set of retractions against everybody until the transaction ends, to change it."""
    await connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})


async def mark(connection: AsyncConnection, pass_ids: Iterable[int]) -> frozenset[int]:
    """Mark passes as the active retractions have it, and return those whose mark has changed."""
    ids = sorted(set(pass_ids))
    if not ids:
        return frozenset()
    return frozenset(row.id for row in await connection.execute(_MARK, {"ids": ids}))
