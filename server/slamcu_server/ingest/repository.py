"""What the ingest asks the database about the things that messages name."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from sqlalchemy import select
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.hd_map import MapIdentity
from slamcu_server.accounts.schemas import MapScope
from slamcu_server.aggregation.boxes import PROBE
from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.database.statements import text
from slamcu_server.database.tables import candidates


async def find_maps(
    connection: AsyncConnection, scope: MapScope, identities: Iterable[MapIdentity]
) -> tuple[dict[str, int], set[MapIdentity]]:
    """Return the ids of the maps of a scope that are here by source, and those of `identities` that are."""
    query = text("""
        SELECT m.source, m.id, asked.version, v.sequence IS NOT NULL AS known
        FROM unnest(CAST(:sources AS text[]), CAST(:versions AS text[])) AS asked (source, version)
        JOIN maps m ON m.source = asked.source
        LEFT JOIN map_versions v ON v.map_id = m.id AND v.version = asked.version""")
    asked = [one for one in identities if one.source in scope]
    found = list(
        await connection.execute(
            query, {"sources": [one.source for one in asked], "versions": [one.version for one in asked]}
        )
    )
    return {row.source: row.id for row in found}, {MapIdentity(row.source, row.version) for row in found if row.known}


async def missing_features(
    connection: AsyncConnection, references: Collection[tuple[int, int]]
) -> set[tuple[int, int]]:
    """Return those (map id, object id) of `references` that have never been mapped: hardly any, hardly ever."""
    if not references:
        return set()
    types = {"map_id": "bigint", "object_id": "bigint"}
    query = text(f"""
        SELECT r.map_id, r.object_id FROM {unnest(types)}
        WHERE NOT EXISTS (SELECT FROM features f WHERE f.map_id = r.map_id AND f.object_id = r.object_id {PROBE})""")  # noqa: S608  (constants)
    result = await connection.execute(
        query, arrays(types, [dict(zip(types, each, strict=True)) for each in references])
    )
    return {(row.map_id, row.object_id) for row in result}


async def find_watches(connection: AsyncConnection, references: Collection[tuple[int, int]]) -> set[tuple[int, int]]:
    """Return those (map id, candidate id) of `references` that have ever been watched."""
    if not references:
        return set()
    query = select(candidates.c.map_id, candidates.c.id).where(candidates.c.id.in_({c for _, c in references}))
    return {(row.map_id, row.id) for row in await connection.execute(query)}.intersection(references)
