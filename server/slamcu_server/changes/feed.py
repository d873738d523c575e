"""Write changes, and append to their feed."""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import text
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.changes.belief import Belief, Beliefs, Kind, State, Subject
from slamcu_server.changes.document import Document, change_document
from slamcu_server.changes.transitions import Published, Transition, decide, leaves

_SALT_BYTES = 16
_CONTENT_TYPES = {"state": "text", "revision": "integer", "document": "text", "lon": "float8", "lat": "float8"}


@dataclass(frozen=True, slots=True)
class Entry:
    """What the feed says next about a change."""

    change_id: int
    map_id: int
    kind: Kind
    state: State
    revision: int
    document: Document


async def publish(connection: AsyncConnection, beliefs: Beliefs, policy: Policy) -> list[Entry]:
    """Write what beliefs make of the changes, and return what is to be appended to the feed.

    Candidates that were merged into others, and features that the map no longer has, say nothing by themselves any
    more: what was open about them is withdrawn. The caller holds the cells of what the beliefs are about.
    """
    subjects = [subject for subject, _ in beliefs.about]
    known = await _newest_changes(
        connection,
        [*(subject.feature_id for subject in subjects if subject.feature_id), *beliefs.unmapped],
        [*(subject.candidate_id for subject in subjects if subject.candidate_id), *beliefs.merged, *beliefs.dissolved],
    )
    sources = await _map_sources(connection, {subject.map_id for subject in subjects})
    opened: list[tuple[Subject, State, Document]] = []
    revised: list[Entry] = []
    left: list[int] = []
    for subject, belief in beliefs.about:
        published = known.get((subject.feature_id, subject.candidate_id))
        if published is not None and leaves(belief, published):
            left.append(published.id)
        transition = decide(belief, published, enter=policy.for_class(belief.feature_class).enter)
        if transition is None:
            continue
        document = _document(subject, belief, transition, published, sources[subject.map_id])
        if published is None or transition.opens:
            opened.append((subject, transition.state, document))
        else:
            revised.append(
                Entry(published.id, subject.map_id, subject.kind, transition.state, published.revision + 1, document)
            )
    revised += _withdrawals(known, beliefs)
    entries = await _open(connection, opened)
    await revise(connection, revised)
    await connection.execute(
        text("UPDATE changes SET evidence_left = true WHERE id = ANY(CAST(:ids AS bigint[])) AND NOT evidence_left"),
        {"ids": sorted(left)},
    )
    return [*entries, *revised]


async def revise(connection: AsyncConnection, entries: Sequence[Entry]) -> None:
    """Write the next revision of changes."""
    types = {"id": "bigint", **_CONTENT_TYPES}
    rows = [{"id": entry.change_id, **_row(entry)} for entry in sorted(entries, key=lambda entry: entry.change_id)]
    await connection.execute(
        text(f"""
        UPDATE changes c SET state = r.state, revision = r.revision, document = CAST(r.document AS jsonb),
               geom = ST_SetSRID(ST_MakePoint(r.lon, r.lat), 4326), updated_at = clock_timestamp()
        FROM {unnest(types)} WHERE c.id = r.id"""),  # noqa: S608  (constants)
        arrays(types, rows),
    )


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


async def _newest_changes(
    connection: AsyncConnection, features: Sequence[int], candidates: Sequence[int]
) -> dict[tuple[int | None, int | None], Published]:
    """Return the newest change about each feature and each candidate, by (feature id, candidate id)."""
    result = await connection.execute(
        text("""
        SELECT DISTINCT ON (kind, feature_id, candidate_id)
               id, map_id, feature_id, candidate_id, state, revision, document, evidence_left
        FROM changes
        WHERE (kind = 'deleted' AND feature_id = ANY(CAST(:features AS bigint[])))
           OR (kind = 'new' AND candidate_id = ANY(CAST(:candidates AS bigint[])))
        ORDER BY kind, feature_id, candidate_id, id DESC""").columns(document=JSONB),
        {"features": sorted(features), "candidates": sorted(candidates)},
    )
    return {
        (row.feature_id, row.candidate_id): Published(
            row.id, row.map_id, State(row.state), row.revision, row.document, row.evidence_left
        )
        for row in result
    }


async def _map_sources(connection: AsyncConnection, ids: set[int]) -> dict[int, str]:
    result = await connection.execute(
        text("SELECT id, source FROM maps WHERE id = ANY(CAST(:ids AS bigint[]))"), {"ids": sorted(ids)}
    )
    return {row.id: row.source for row in result}


def _document(
    subject: Subject, belief: Belief, transition: Transition, published: Published | None, map_source: str
) -> Document:
    confirmed_at = belief.stood_since
    if transition.state is State.WITHDRAWN and published is not None:
        before = published.document["confirmed_at"]
        confirmed_at = datetime.fromisoformat(before) if before else None
    return change_document(
        belief,
        map_source=map_source,
        map_object_id=subject.map_object_id,
        watch_id=subject.candidate_id,
        confirmed_at=confirmed_at,
    )


def _withdrawals(known: Mapping[tuple[int | None, int | None], Published], beliefs: Beliefs) -> list[Entry]:
    """Withdraw what is open about things that say nothing by themselves any more."""
    moot: list[tuple[Kind, tuple[int | None, int | None], Document]] = [
        *((Kind.DELETED, (key, None), {}) for key in sorted(beliefs.unmapped)),
        *((Kind.NEW, (None, key), {"merged_into": beliefs.merged[key]}) for key in sorted(beliefs.merged)),
        *((Kind.NEW, (None, key), {}) for key in sorted(beliefs.dissolved)),
    ]
    entries: list[Entry] = []
    for kind, key, why in moot:
        change = known.get(key)
        if change is not None and change.state in (State.CANDIDATE, State.CONFIRMED):
            document = {**change.document, **why}
            entries.append(Entry(change.id, change.map_id, kind, State.WITHDRAWN, change.revision + 1, document))
    return entries


async def _open(connection: AsyncConnection, changes: Sequence[tuple[Subject, State, Document]]) -> list[Entry]:
    types = {
        "map_id": "bigint",
        "kind": "text",
        "feature_id": "bigint",
        "candidate_id": "bigint",
        "salt": "bytea",
        **_CONTENT_TYPES,
    }
    rows = [
        {
            "map_id": subject.map_id,
            "kind": subject.kind.value,
            "feature_id": subject.feature_id,
            "candidate_id": subject.candidate_id,
            "salt": secrets.token_bytes(_SALT_BYTES),
            **_content(state, 1, document),
        }
        for subject, state, document in changes
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
        Entry(ids[subject.feature_id, subject.candidate_id], subject.map_id, subject.kind, state, 1, document)
        for subject, state, document in changes
    ]


def _row(entry: Entry) -> dict[str, Any]:
    return _content(entry.state, entry.revision, entry.document)


def _content(state: State, revision: int, document: Document) -> dict[str, Any]:
    lon, lat = document["geometry"]["coordinates"]
    return {
        "state": state.value,
        "revision": revision,
        "document": json.dumps(document, allow_nan=False),
        "lon": lon,
        "lat": lat,
    }
