"""What the ingest asks the database about the things that messages name."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from sqlalchemy import select, text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.hd_map import MapIdentity
from slamcu_server.database.tables import candidates


async def find_maps(
    connection: AsyncConnection, identities: Iterable[MapIdentity]
) -> tuple[dict[str, int], set[MapIdentity]]:
    """Return the ids of the maps that are here by source, and those of `identities` that are."""
    query = text("""
        SELECT m.source, m.id, asked.version, v.sequence IS NOT NULL AS known
        FROM unnest(CAST(:sources AS text[]), CAST(:versions AS text[])) AS asked (source, version)
        JOIN maps m ON m.source = asked.source
        LEFT JOIN map_versions v ON v.map_id = m.id AND v.version = asked.version""")
    asked = list(identities)
    found = list(
        await connection.execute(
            query, {"sources": [one.source for one in asked], "versions": [one.version for one in asked]}
        )
    )
    return {row.source: row.id for row in found}, {MapIdentity(row.source, row.version) for row in found if row.known}


async def find_features(connection: AsyncConnection, references: Collection[tuple[int, int]]) -> set[tuple[int, int]]:
    """Return those (map id, object id) of `references` that have ever been mapped."""
    if not references:
        return set()
    query = text("""
        SELECT map_id, object_id FROM features
        JOIN unnest(CAST(:maps AS bigint[]), CAST(:objects AS bigint[])) AS asked (map_id, object_id)
            USING (map_id, object_id)""")
    result = await connection.execute(
        query, {"maps": [m for m, _ in references], "objects": [o for _, o in references]}
    )
    return {(row.map_id, row.object_id) for row in result}


async def find_watches(connection: AsyncConnection, references: Collection[tuple[int, int]]) -> set[tuple[int, int]]:
    """Return those (map id, candidate id) of `references` that have ever been watched."""
    if not references:
        return set()
    query = select(candidates.c.map_id, candidates.c.id).where(candidates.c.id.in_({c for _, c in references}))
    return {(row.map_id, row.id) for row in await connection.execute(query)}.intersection(references)
