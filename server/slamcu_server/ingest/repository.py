"""What the ingest asks the database about the things that messages name."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from sqlalchemy import select, text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.hd_map import MapIdentity
from slamcu_server.database.tables import candidates, map_versions, maps


async def find_maps(connection: AsyncConnection, sources: Collection[str]) -> dict[str, int]:
    """Return the ids of those maps of `sources` that are here."""
    query = select(maps.c.source, maps.c.id).where(maps.c.source.in_(sources))
    return {row.source: row.id for row in await connection.execute(query)}


async def find_versions(connection: AsyncConnection, identities: Iterable[MapIdentity]) -> set[MapIdentity]:
    """Return those of `identities` that are here."""
    asked = list(identities)
    query = (
        select(maps.c.source, map_versions.c.version)
        .join_from(maps, map_versions)
        .where(maps.c.source.in_({one.source for one in asked}))
        .where(map_versions.c.version.in_({one.version for one in asked}))
    )
    return {MapIdentity(row.source, row.version) for row in await connection.execute(query)}.intersection(asked)


async def find_features(connection: AsyncConnection, references: Collection[tuple[int, int]]) -> set[tuple[int, int]]:
    """Return those (map id, object id) of `references` that have ever been mapped."""
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
    query = select(candidates.c.map_id, candidates.c.id).where(candidates.c.id.in_({c for _, c in references}))
    return {(row.map_id, row.id) for row in await connection.execute(query)}.intersection(references)
