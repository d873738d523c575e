"""What contributors said about each thing, read piece by piece."""

from __future__ import annotations

from collections.abc import AsyncIterator
from datetime import datetime

from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import About, Testimony

_THINGS = 1000
"""Map features or candidates that one statement reads about."""

_LEAST_WEIGHT = 0.7
"""Weight of evidence from which a pass says something: half of the mass."""

# Passes that an admin took out say nothing. Those of a gated session are judged, so that the gate may open again.
_QUERY = """
    SELECT p.{key} AS thing, p.contributor_id, m.session_id, extract(epoch FROM p.ended_at)::float8 AS time,
           p.weight_for > p.weight_against AS exists, p.status = 'NOT_EXPECTED_AND_DETECTED' AS find,
           p.retraction_id IS NULL AS heard
    FROM passes p JOIN messages m ON m.id = p.message LEFT JOIN retractions r ON r.id = p.retraction_id
    WHERE p.{key} > :after AND p.{key} <= :last AND p.ended_at >= :since AND p.trusted AND p.valid {also}
      AND p.status <> 'EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED'
      AND greatest(p.weight_for, p.weight_against) >= :least
      AND (r.id IS NULL OR (r.requested_by IS NULL AND r.session_id IS NOT NULL))
    ORDER BY p.{key}"""
_LAST = """
    SELECT max({key}) FROM (
        SELECT DISTINCT {key} FROM passes WHERE {key} > :after {also} ORDER BY {key} LIMIT :count) few"""
_KEYS = {
    About.MAPPED: {"key": "feature_id", "also": ""},
    About.CANDIDATE: {"key": "candidate_id", "also": ""},
}


async def read(connection: AsyncConnection, about: About, since: datetime) -> AsyncIterator[list[list[Testimony]]]:
    """Yield what was said about map features, or candidates, a thousand of them at a time, each in a list."""
    names = _KEYS[about]
    after = 0
    while True:
        last = (
            await connection.execute(text(_LAST.format(**names)), {"after": after, "count": _THINGS})
        ).scalar_one_or_none()
        if last is None:
            return
        found = await connection.execute(
            text(_QUERY.format(**names)), {"after": after, "last": last, "since": since, "least": _LEAST_WEIGHT}
        )
        things: dict[int, list[Testimony]] = {}
        for row in found:
            things.setdefault(row.thing, []).append(
                Testimony(row.contributor_id, row.session_id, row.time, row.exists, row.find, row.heard)
            )
        yield list(things.values())
        after = last
