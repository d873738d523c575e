"""Retractions in the database, and the list of passes that are still to be corrected."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from sqlalchemy import Row, func, insert, select, text
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.aggregation import aside
from slamcu_server.aggregation.aside import Work, due, fresh
from slamcu_server.database.tables import accounts, corrections, put_aside, retractions
from slamcu_server.retraction.filter import FIELDS, EvidenceFilter
from slamcu_server.retraction.marks import ACTIVE


class State(StrEnum):
    """The states of a retraction: it holds in the first three."""

    REQUESTED = "requested"  # holds for what comes; what is stored is not listed yet
    APPLYING = "applying"
    APPLIED = "applied"
    UNDO_REQUESTED = "undo_requested"
    UNDOING = "undoing"
    UNDONE = "undone"


@dataclass(frozen=True, slots=True)
class Extent:
    """How much a retraction takes out."""

    passes: int
    features: int
    candidates: int


@dataclass(frozen=True, slots=True)
class StoredRetraction:
    """A retraction with the names of those who asked for it."""

    id: int
    state: State
    names: EvidenceFilter
    contributor: str | None
    reason: str
    requested_by: str | None  # None: the server itself
    requested_at: datetime
    applied_at: datetime | None
    passes: int | None
    features: int | None
    candidates: int | None
    put_aside: int  # of the passes that are still to be corrected, those that failed
    undo_reason: str | None
    undone_by: str | None
    undone_at: datetime | None


_CONTRIBUTOR, _REQUESTER, _UNDOER = (accounts.alias(name) for name in ("contributor", "requester", "undoer"))
_PUT_ASIDE = (
    select(func.count())
    .select_from(corrections)
    .join(put_aside, (put_aside.c.work == Work.CORRECTION) & (put_aside.c.key == corrections.c.id))
    .where(corrections.c.retraction_id == retractions.c.id)
    .scalar_subquery()
)
_QUERY = (
    select(
        retractions,
        _PUT_ASIDE.label("put_aside"),
        _CONTRIBUTOR.c.label.label("contributor"),
        _REQUESTER.c.label.label("requester"),
        _UNDOER.c.label.label("undoer"),
    )
    .join(_CONTRIBUTOR, _CONTRIBUTOR.c.id == retractions.c.contributor_id, isouter=True)
    .join(_REQUESTER, _REQUESTER.c.id == retractions.c.requested_by, isouter=True)
    .join(_UNDOER, _UNDOER.c.id == retractions.c.undone_by, isouter=True)
)


async def add(connection: AsyncConnection, names: EvidenceFilter, reason: str, requested_by: int | None) -> int:
    """Write a retraction and return its id."""
    values = {**names.parameters, "reason": reason, "requested_by": requested_by}
    return int((await connection.execute(insert(retractions).values(values).returning(retractions.c.id))).scalar_one())


async def find(connection: AsyncConnection, retraction_id: int) -> StoredRetraction | None:
    """Return a retraction."""
    row = (await connection.execute(_QUERY.where(retractions.c.id == retraction_id))).one_or_none()
    return None if row is None else _stored(row)


async def find_active(connection: AsyncConnection, names: EvidenceFilter) -> StoredRetraction | None:
    """Return the active retraction of exactly these passes."""
    query = _QUERY.where(retractions.c.state.in_([State.REQUESTED, State.APPLYING, State.APPLIED]))
    for name in FIELDS:
        query = query.where(retractions.c[name].is_not_distinct_from(getattr(names, name)))
    row = (await connection.execute(query.order_by(retractions.c.id).limit(1))).one_or_none()
    return None if row is None else _stored(row)


async def list_after(connection: AsyncConnection, after: int, limit: int) -> list[StoredRetraction]:
    """Return up to `limit` retractions whose ids follow `after`."""
    rows = await connection.execute(_QUERY.where(retractions.c.id > after).order_by(retractions.c.id).limit(limit))
    return [_stored(row) for row in rows]


async def list_gates(connection: AsyncConnection) -> dict[tuple[int, str], int]:
    """Return the sessions that the server itself has taken out, (contributor, session id), with their retractions."""
    found = await connection.execute(
        text(f"""
        SELECT contributor_id, session_id, id FROM retractions
        WHERE requested_by IS NULL AND session_id IS NOT NULL AND state IN {ACTIVE}""")  # noqa: S608  (a constant)
    )
    return {(row.contributor_id, row.session_id): row.id for row in found}


async def request_undo(connection: AsyncConnection, retraction_id: int, reason: str, undone_by: int | None) -> None:
    """Let a retraction hold no longer."""
    await connection.execute(
        text("""
        UPDATE retractions SET state = 'undo_requested', undo_reason = :reason, undone_by = :by,
            undo_requested_at = clock_timestamp() WHERE id = :id"""),
        {"id": retraction_id, "reason": reason, "by": undone_by},
    )


async def measure(connection: AsyncConnection, names: EvidenceFilter) -> Extent:
    """Count what a retraction would take out that is not out yet."""
    result = await connection.execute(
        text(f"""
        SELECT count(*) AS passes, count(DISTINCT p.feature_id) AS features,
               count(DISTINCT p.candidate_id) AS candidates
        FROM passes p JOIN messages m ON m.id = p.message WHERE p.retraction_id IS NULL AND {names.condition}"""),  # noqa: S608  (constants)
        names.parameters,
    )
    row = result.one()
    return Extent(row.passes, row.features, row.candidates)


async def anything_to_correct(connection: AsyncConnection) -> bool:
    """Whether a retraction is to be listed, applied or undone, or a pass is listed."""
    query = """
        SELECT EXISTS (SELECT FROM retractions WHERE state IN ('requested', 'applying', 'undo_requested', 'undoing'))
            OR EXISTS (SELECT FROM corrections)"""
    return bool((await connection.execute(text(query))).scalar_one())


async def claim(connection: AsyncConnection, states: Collection[State]) -> StoredRetraction | None:
    """Lock the oldest retraction in one of the states that nobody else holds."""
    query = (
        _QUERY.where(retractions.c.state.in_(states), text(due(Work.RETRACTION, "retractions.id")))
        .order_by(retractions.c.id)
        .limit(1)
        .with_for_update(of=retractions, skip_locked=True)
    )
    row = (await connection.execute(query)).one_or_none()
    return None if row is None else _stored(row)


async def list_passes(connection: AsyncConnection, retraction: StoredRetraction) -> None:
    """List the stored passes that a retraction names, and say how many they are."""
    extent = await measure(connection, retraction.names)
    await connection.execute(
        text(f"""
        INSERT INTO corrections (pass_id, retraction_id)
        SELECT p.id, :retraction FROM passes p JOIN messages m ON m.id = p.message
        WHERE p.retraction_id IS NULL AND {retraction.names.condition} ORDER BY {_BY_PLACE}"""),  # noqa: S608  (constants)
        {**retraction.names.parameters, "retraction": retraction.id},
    )
    await connection.execute(
        text("""
        UPDATE retractions SET state = 'applying', passes = :passes, features = :features, candidates = :candidates
        WHERE id = :id"""),
        {"id": retraction.id, "passes": extent.passes, "features": extent.features, "candidates": extent.candidates},
    )


async def list_marked(connection: AsyncConnection, retraction: StoredRetraction) -> None:
    """List the passes that a retraction has taken out."""
    await connection.execute(
        text(f"""
        INSERT INTO corrections (pass_id, retraction_id)
        SELECT p.id, :retraction FROM passes p WHERE p.retraction_id = :retraction ORDER BY {_BY_PLACE}"""),  # noqa: S608  (constants)
        {"retraction": retraction.id},
    )
    await connection.execute(text("UPDATE retractions SET state = 'undoing' WHERE id = :id"), {"id": retraction.id})


async def claim_corrections(connection: AsyncConnection, limit: int, ids: Sequence[int] | None = None) -> list[int]:
    """Lock up to `limit` entries of the list (of `ids`, if given) that nobody else holds, and return their ids.

    Those that never failed come first, and else one that did, alone, when its time has come.
    """
    if ids is not None:
        return await _claim_corrections(
            connection, "l.id = ANY(CAST(:ids AS bigint[])) ORDER BY l.id", limit, list(ids)
        )
    claimed = await _claim_corrections(connection, f"{fresh(Work.CORRECTION, 'l.id')} ORDER BY l.id", limit)
    return claimed or await _claim_corrections(connection, _DUE, 1)


_DUE = f"""
    l.id IN (SELECT key FROM put_aside WHERE work = '{Work.CORRECTION}' AND retry_at <= now()) ORDER BY l.id"""  # noqa: S608  (constants)


async def _claim_corrections(connection: AsyncConnection, which: str, limit: int, ids: Sequence[int] = ()) -> list[int]:
    query = f"SELECT l.id FROM corrections l WHERE {which} LIMIT :limit FOR UPDATE OF l SKIP LOCKED"  # noqa: S608
    return list((await connection.execute(text(query), {"limit": limit, "ids": ids})).scalars())


async def strike_off(connection: AsyncConnection, ids: Sequence[int]) -> None:
    """Take corrections that are done off the list."""
    await connection.execute(text("DELETE FROM corrections WHERE id = ANY(CAST(:ids AS bigint[]))"), {"ids": list(ids)})
    await aside.done(connection, Work.CORRECTION, ids)


async def finish(connection: AsyncConnection) -> int:
    """Say of retractions of which nothing is listed any more that they are done; return how many."""
    result = await connection.execute(
        text("""
        UPDATE retractions r SET
            state = CASE state WHEN 'applying' THEN 'applied' ELSE 'undone' END,
            applied_at = CASE state WHEN 'applying' THEN clock_timestamp() ELSE applied_at END,
            undone_at = CASE state WHEN 'undoing' THEN clock_timestamp() END
        WHERE state IN ('applying', 'undoing')
          AND NOT EXISTS (SELECT FROM corrections WHERE retraction_id = r.id)""")
    )
    return result.rowcount


_BY_PLACE = "p.map_id, p.feature_id, p.watch_id, round(ST_Y(p.geom)::numeric, 2), ST_X(p.geom), p.id"
"""An order in which a piece of the list touches few things, and few cells."""


def _stored(row: Row[tuple[object, ...]]) -> StoredRetraction:
    return StoredRetraction(
        id=row.id,
        state=State(row.state),
        names=EvidenceFilter(**{name: getattr(row, name) for name in FIELDS}),
        contributor=row.contributor,
        reason=row.reason,
        requested_by=row.requester,
        requested_at=row.requested_at,
        applied_at=row.applied_at,
        passes=row.passes,
        features=row.features,
        candidates=row.candidates,
        put_aside=row.put_aside,
        undo_reason=row.undo_reason,
        undone_by=row.undoer,
        undone_at=row.undone_at,
    )
