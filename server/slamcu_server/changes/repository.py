"""Changes and their feed in the database."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, Select, select, text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy
from slamcu_server.accounts.schemas import MapScope
from slamcu_server.changes.belief import Kind, State
from slamcu_server.changes.document import Document
from slamcu_server.database.tables import change_entries, changes, feed_position, maps, policies
from slamcu_server.maps.bbox import BoundingBox


@dataclass(frozen=True, slots=True)
class FeedQuery:
    """Which entries of the feed are asked for."""

    after: int
    limit: int
    scope: MapScope
    bbox: BoundingBox | None = None
    kinds: Sequence[Kind] = ()
    states: Sequence[State] = ()
    map_source: str | None = None
    latest: bool = False  # only the newest entry of each change


@dataclass(frozen=True, slots=True)
class StoredChange:
    """A change as it is now."""

    id: int
    map_id: int
    map_source: str
    kind: Kind
    state: State
    revision: int
    document: Document
    feature_id: int | None
    candidate_id: int | None
    salt: bytes

    @property
    def etag(self) -> str:
        """The tag that a review must name: it differs for every revision."""
        return f'"{self.id}-{self.revision}"'


async def list_entries(connection: AsyncConnection, query: FeedQuery) -> list[Row[Any]]:
    """Return up to `limit` entries that follow the sequence `after`."""
    columns = change_entries.c
    chosen: Select[Any] = (
        select(
            columns.sequence,
            columns.change_id,
            columns.kind,
            columns.state,
            columns.revision,
            columns.document,
            columns.created_at,
        )
        .where(columns.sequence > query.after)
        .order_by(columns.sequence)
        .limit(query.limit)
    )
    if query.bbox is not None:
        chosen = chosen.where(query.bbox.contains(columns.geom))
    if query.kinds:
        chosen = chosen.where(columns.kind.in_([kind.value for kind in query.kinds]))
    if query.states:
        chosen = chosen.where(columns.state.in_([state.value for state in query.states]))
    if query.map_source is not None or query.scope.sources is not None:
        chosen = chosen.join(maps, maps.c.id == columns.map_id)
    if query.map_source is not None:
        chosen = chosen.where(maps.c.source == query.map_source)
    if query.scope.sources is not None:
        chosen = chosen.where(maps.c.source.in_(query.scope.sources))
    if query.latest:
        newest = (changes.c.id == columns.change_id) & (changes.c.revision == columns.revision)
        chosen = chosen.join(changes, newest)
    return list(await connection.execute(chosen))


async def list_history(connection: AsyncConnection, change_id: int) -> list[Row[Any]]:
    """Return what was said about a change, oldest first."""
    columns = change_entries.c
    query = (
        select(columns.sequence, columns.state, columns.revision, columns.created_at)
        .where(columns.change_id == change_id)
        .order_by(columns.sequence)
    )
    return list(await connection.execute(query))


async def last_sequence(connection: AsyncConnection) -> int:
    """Return the newest sequence number of the feed that is visible."""
    return int((await connection.execute(select(feed_position.c.last_sequence))).scalar_one())


async def find_change(connection: AsyncConnection, change_id: int) -> StoredChange | None:
    """Return a change."""
    query = select(changes, maps.c.source).join_from(changes, maps).where(changes.c.id == change_id)
    row = (await connection.execute(query)).one_or_none()
    if row is None:
        return None
    return StoredChange(
        id=row.id,
        map_id=row.map_id,
        map_source=row.source,
        kind=Kind(row.kind),
        state=State(row.state),
        revision=row.revision,
        document=row.document,
        feature_id=row.feature_id,
        candidate_id=row.candidate_id,
        salt=bytes(row.salt),
    )


async def find_policy(connection: AsyncConnection, version: str) -> Policy | None:
    """Return the policy of a version."""
    query = select(policies.c.document).where(policies.c.version == version)
    document = (await connection.execute(query)).scalar_one_or_none()
    return None if document is None else Policy.from_document(document)


async def founding_place(connection: AsyncConnection, candidate_id: int) -> tuple[float, float]:
    """Return longitude and latitude of the pass that founded a candidate."""
    query = text("""
        SELECT ST_X(p.geom) AS lon, ST_Y(p.geom) AS lat
        FROM candidates c JOIN passes p ON p.id = c.founding_pass WHERE c.id = :id""")
    row = (await connection.execute(query, {"id": candidate_id})).one()
    return row.lon, row.lat
