"""Write changes, and append to their feed: what `feed` has decided to say."""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.changes.belief import Kind, State
from slamcu_server.changes.document import Document
from slamcu_server.database.statements import text

_SALT_BYTES = 16
_CONTENT_TYPES = {"state": "text", "revision": "integer", "document": "text", "lon": "float8", "lat": "float8"}


Ends = tuple[int | None, int | None]  # feature id, candidate id


@dataclass(frozen=True, slots=True)
class Entry:
    """What the feed says next about a change."""

    change_id: int
    map_id: int
    kind: Kind
    state: State
    revision: int
    document: Document
    ends: Ends | None = None  # what it is about from now on; None: what it was
    written: str | None = None  # the document as `write` writes it, where it is written twice


def write(document: Document) -> str:
    """Return a document as JSON."""
    return json.dumps(document, allow_nan=False)


async def revise(connection: AsyncConnection, entries: Sequence[Entry]) -> None:
    """Write the next revision of changes."""
    if not entries:
        return
    types = {"id": "bigint", **_CONTENT_TYPES}
    rows = [{"id": entry.change_id, **_row(entry)} for entry in sorted(entries, key=lambda entry: entry.change_id)]
    await connection.execute(
        text(f"""
        UPDATE changes c SET state = r.state, revision = r.revision, document = CAST(r.document AS jsonb),
               geom = ST_SetSRID(ST_MakePoint(r.lon, r.lat), 4326), updated_at = clock_timestamp()
        FROM {unnest(types)} WHERE c.id = r.id"""),  # noqa: S608  (constants)
        arrays(types, rows),
    )
    turned = {entry.change_id: (entry.kind, entry.ends) for entry in entries if entry.ends is not None}
    if turned:
        await _turn(connection, turned)


async def _turn(connection: AsyncConnection, about: Mapping[int, tuple[Kind, Ends]]) -> None:
    """Say what changes are about from now on."""
    types = {"id": "bigint", "kind": "text", "feature": "bigint", "candidate": "bigint"}
    rows = [
        {"id": key, "kind": kind.value, "feature": ends[0], "candidate": ends[1]}
        for key, (kind, ends) in sorted(about.items())
    ]
    await connection.execute(
        text(f"""
        UPDATE changes c SET kind = r.kind, feature_id = r.feature, candidate_id = r.candidate
        FROM {unnest(types)} WHERE c.id = r.id
        AND (c.kind, c.feature_id, c.candidate_id) IS DISTINCT FROM (r.kind, r.feature, r.candidate)"""),  # noqa: S608  (constants)
        arrays(types, rows),
    )


async def settle(connection: AsyncConnection, entries: Sequence[Entry]) -> None:
    """Note of changes that the map says by now since when, and since when it was known: how long the way took."""
    types = {"id": "bigint", "first": "timestamptz", "mapped": "timestamptz"}
    rows = [
        {"id": entry.change_id, "first": _time(entry, "first_evidence"), "mapped": _time(entry, "mapped_at")}
        for entry in entries
        if entry.document.get("mapped_at") is not None
    ]
    await connection.execute(
        text(f"""
        UPDATE changes c SET first_evidence_at = r.first, mapped_at = r.mapped
        FROM {unnest(types)} WHERE c.id = r.id"""),  # noqa: S608  (constants)
        arrays(types, rows),
    )


def _time(entry: Entry, name: str) -> datetime | None:
    told = entry.document.get(name)
    return None if told is None else datetime.fromisoformat(told)


async def append(connection: AsyncConnection, entries: Sequence[Entry]) -> None:
    """Append to the feed: the last thing a transaction does.

    Everybody who appends waits here for the one counter row until the one before has committed. So the sequence has
    no gaps, its order is that of the commits, and a reader who has seen a number has seen all below it.
    """
    if not entries:
        return
    result = await connection.execute(
        text("UPDATE feed_position SET last_sequence = last_sequence + :count RETURNING last_sequence"),
        {"count": len(entries)},
    )
    first = int(result.scalar_one()) - len(entries) + 1
    types = {"sequence": "bigint", "change_id": "bigint", "map_id": "bigint", "kind": "text", **_CONTENT_TYPES}
    rows = [
        {
            "sequence": first + index,
            "change_id": entry.change_id,
            "map_id": entry.map_id,
            "kind": entry.kind.value,
            **_row(entry),
        }
        for index, entry in enumerate(entries)
    ]
    await connection.execute(
        text(f"""
        INSERT INTO change_entries (sequence, change_id, map_id, kind, state, revision, document, geom, created_at)
        SELECT sequence, change_id, map_id, kind, state, revision, CAST(document AS jsonb),
               ST_SetSRID(ST_MakePoint(lon, lat), 4326), clock_timestamp()
        FROM {unnest(types)}"""),  # noqa: S608  (constants)
        arrays(types, rows),
    )


async def open_changes(
    connection: AsyncConnection, changes: Sequence[tuple[int, Kind, Ends, State, Document]]
) -> list[Entry]:
    """Write changes that are new, given as (map id, kind, ends, state, document), and return their first entries."""
    types = {
        "map_id": "bigint",
        "kind": "text",
        "feature_id": "bigint",
        "candidate_id": "bigint",
        "salt": "bytea",
        **_CONTENT_TYPES,
    }
    if not changes:
        return []
    written = [write(document) for *_, document in changes]
    rows = [
        {
            "map_id": map_id,
            "kind": kind.value,
            "feature_id": ends[0],
            "candidate_id": ends[1],
            "salt": secrets.token_bytes(_SALT_BYTES),
            **_content(state, 1, document, told),
        }
        for (map_id, kind, ends, state, document), told in zip(changes, written, strict=True)
    ]
    result = await connection.execute(
        text(f"""
        INSERT INTO changes (map_id, kind, state, feature_id, candidate_id, revision, document, salt, geom)
        SELECT map_id, kind, state, feature_id, candidate_id, revision, CAST(document AS jsonb), salt,
               ST_SetSRID(ST_MakePoint(lon, lat), 4326)
        FROM {unnest(types)} RETURNING id, feature_id, candidate_id"""),  # noqa: S608  (constants)
        arrays(types, rows),
    )
    ids = {(row.feature_id, row.candidate_id): row.id for row in result}
    return [
        Entry(ids[ends], map_id, kind, state, 1, document, written=told)
        for (map_id, kind, ends, state, document), told in zip(changes, written, strict=True)
    ]


def _row(entry: Entry) -> dict[str, Any]:
    return _content(entry.state, entry.revision, entry.document, entry.written or write(entry.document))


def _content(state: State, revision: int, document: Document, written: str) -> dict[str, Any]:
    lon, lat = document["geometry"]["coordinates"]
    return {
        "state": state.value,
        "revision": revision,
        "document": written,
        "lon": lon,
        "lat": lat,
    }
