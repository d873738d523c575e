"""Candidates whose founding pass was taken out: each is bound to another of its finds, or dissolved.

Without the pass that is gone, the next find would have founded the candidate, and vehicles would have reported about it
under that find's id. So the id goes on with the first of the candidate's finds that founds none yet. If vehicles saw it
as a watch feature only, the first of them becomes the find that it would have been: what it saw where counts the same.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from sqlalchemy import Row, text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation.refold import Places

# also what was dissolved before, where a report that names it comes now, or comes back
_LOST = text("""
    SELECT c.id, COALESCE(c.merged_into, c.id) AS root
    FROM candidates c JOIN passes p ON p.id = c.founding_pass
    WHERE p.retraction_id IS NOT NULL AND c.feature_id IS NULL
      AND (p.id = ANY(CAST(:passes AS bigint[])) OR c.id IN (
        SELECT watch_id FROM passes WHERE id = ANY(CAST(:passes AS bigint[])) AND retraction_id IS NULL))
    ORDER BY c.id""")
_HEIR = """
    SELECT p.id, p.map_id, ST_X(p.geom) AS lon, ST_Y(p.geom) AS lat FROM passes p JOIN messages m ON m.id = p.message
    WHERE {whose} AND p.feature_id IS NULL AND p.retraction_id IS NULL AND NOT p.archived
      AND p.valid AND p.geom IS NOT NULL
      AND NOT EXISTS (SELECT FROM candidates c WHERE c.founding_pass = p.id)
    ORDER BY p.trusted DESC, p.ended_at, p.contributor_id, m.session_id, m.message_id, p.index_in_message LIMIT 1"""
_FIND_HEIR = text(
    _HEIR.format(whose="p.candidate_id = :root AND p.watch_id IS NULL AND p.status = 'NOT_EXPECTED_AND_DETECTED'")
)
_WATCH_HEIR = text(_HEIR.format(whose="p.watch_id = :id AND p.status = 'EXPECTED_AND_DETECTED'"))


@dataclass(frozen=True, slots=True)
class PassedOn:
    """What has become of candidates without their founding passes."""

    dissolved: frozenset[int]
    places: Places  # of the finds to which the others are bound now


async def pass_on(connection: AsyncConnection, pass_ids: Collection[int]) -> PassedOn:
    """Bind the candidates that these passes founded, and no longer can, to others, or dissolve them.

    So are those that these passes name and that were dissolved before: it does not matter who came first.
    """
    lost = list(await connection.execute(_LOST, {"passes": sorted(pass_ids)}))
    dissolved: set[int] = set()
    places: set[tuple[int, float, float]] = set()
    for candidate in lost:
        heir = await _heir(connection, candidate)
        if heir is None:
            dissolved.add(candidate.id)
            continue
        places.add((heir.map_id, heir.lon, heir.lat))
        await connection.execute(
            text("UPDATE candidates SET founding_pass = :heir WHERE id = :id"), {"heir": heir.id, "id": candidate.id}
        )
    await _dissolve(connection, dissolved)
    return PassedOn(frozenset(dissolved), frozenset(places))


async def _heir(
    connection: AsyncConnection, candidate: Row[tuple[int, int]]
) -> Row[tuple[int, int, float, float]] | None:
    heir = (await connection.execute(_FIND_HEIR, {"root": candidate.root})).one_or_none()
    if heir is not None:
        return heir
    heir = (await connection.execute(_WATCH_HEIR, {"id": candidate.id})).one_or_none()
    if heir is not None:
        await connection.execute(
            text("UPDATE passes SET watch_id = NULL, status = 'NOT_EXPECTED_AND_DETECTED' WHERE id = :id"),
            {"id": heir.id},
        )
    return heir


async def _dissolve(connection: AsyncConnection, ids: Collection[int]) -> None:
    """Let candidates be part of nothing but themselves, until their founding passes come back."""
    parameters = {"ids": sorted(ids)}
    await connection.execute(
        text("UPDATE candidates SET merged_into = id WHERE id = ANY(CAST(:ids AS bigint[]))"), parameters
    )
    await connection.execute(
        text("UPDATE passes SET candidate_id = NULL WHERE candidate_id = ANY(CAST(:ids AS bigint[])) AND NOT archived"),
        parameters,
    )
