"""From beliefs to what the feed says: read what was said, decide, write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy, Trusts
from slamcu_server.changes.belief import DENIED, Beliefs, Kind, State
from slamcu_server.changes.claims import claims, read
from slamcu_server.changes.document import Document, claim_document, withdrawn_document
from slamcu_server.changes.entries import Entry, append, open_changes, revise, settle, write
from slamcu_server.changes.plan import Said, plan
from slamcu_server.changes.transitions import Published
from slamcu_server.database.statements import text

__all__ = ["Entry", "append", "publish", "revise", "settle"]


async def publish(connection: AsyncConnection, beliefs: Beliefs, policy: Policy) -> list[Entry]:
    """Write what beliefs make of the changes, and return what is to be appended to the feed.

    Candidates that were merged into others, and features that the map no longer has, say nothing by themselves any
    more: what was open about them is withdrawn. The caller holds the cells of what the beliefs are about.
    """
    if not (beliefs.about or beliefs.merged or beliefs.unmapped or beliefs.dissolved):
        return []
    subjects = [subject for subject, _ in beliefs.about]
    known = await _known_changes(
        connection,
        [*(subject.feature_id for subject in subjects if subject.feature_id), *beliefs.unmapped],
        [*(subject.candidate_id for subject in subjects if subject.candidate_id), *beliefs.merged, *beliefs.dissolved],
    )
    maps = await _maps(connection, {subject.map_id for subject in subjects})
    voices = read(beliefs, policy, _as_of(beliefs, maps))
    said = plan(claims(voices, beliefs.pairs, known, policy), beliefs, known, policy)
    opened = [
        (one.claim.leading.subject.map_id, one.claim.kind, one.claim.ends, one.state, _document(one, maps, policy))
        for one in said
        if one.published is None and one.claim is not None
    ]
    revised = [_revision(one.published, one, _document(one, maps, policy)) for one in said if one.published is not None]
    entries = await open_changes(connection, opened)
    await revise(connection, revised)
    await _note_evidence_that_left(connection, [row.id for row in known if row.state in DENIED])
    return [*entries, *revised]


def _revision(published: Published, one: Said, document: Document) -> Entry:
    if one.claim is None or one.state is State.WITHDRAWN:
        kind, ends = published.kind, None
    else:
        kind, ends = one.claim.kind, one.claim.ends
    return Entry(
        published.id, published.map_id, kind, one.state, published.revision + 1, document, ends, write(document)
    )


def _document(one: Said, maps: Mapping[int, tuple[str, datetime | None]], policy: Policy) -> Document:
    before = None if one.published is None else one.published.document
    trusts = policy.default.trusts or Trusts()
    versions = {"policy_version": policy.version, "trust_version": trusts.version}
    if one.published is not None and (one.claim is None or one.state is State.WITHDRAWN):
        return withdrawn_document(one.published, one.claim, {**one.why, **versions})
    if one.claim is None:
        raise ValueError("what is said for the first time is said by somebody")
    source, _ = maps[one.claim.leading.subject.map_id]
    return claim_document(one.claim, source, before) | versions


def _as_of(beliefs: Beliefs, maps: Mapping[int, tuple[str, datetime | None]]) -> dict[int, datetime]:
    """Return the time of each map: that of the newest report known, so that a replay of a year tells what it told."""
    times: dict[int, datetime] = {key: time for key, (_, time) in maps.items() if time is not None}
    for subject, belief in beliefs.about:
        if belief.last_looked is not None:
            times[subject.map_id] = max(times.get(subject.map_id, belief.last_looked), belief.last_looked)
    return times


async def _known_changes(
    connection: AsyncConnection, features: Sequence[int], candidates: Sequence[int]
) -> list[Published]:
    """Return the changes about these features and candidates, oldest first."""
    result = await connection.execute(
        text("""
        SELECT id, map_id, kind, feature_id, candidate_id, state, revision, document, evidence_left FROM changes
        WHERE feature_id = ANY(CAST(:features AS bigint[])) OR candidate_id = ANY(CAST(:candidates AS bigint[]))
        ORDER BY id"""),
        {"features": sorted(features), "candidates": sorted(candidates)},
    )
    return [
        Published(
            row.id,
            row.map_id,
            Kind(row.kind),
            State(row.state),
            row.revision,
            row.document,
            row.feature_id,
            row.candidate_id,
            row.evidence_left,
        )
        for row in result.all()
    ]


async def _maps(connection: AsyncConnection, ids: set[int]) -> dict[int, tuple[str, datetime | None]]:
    result = await connection.execute(
        text("SELECT id, source, evidence_time FROM maps WHERE id = ANY(CAST(:ids AS bigint[]))"), {"ids": sorted(ids)}
    )
    return {row.id: (row.source, row.evidence_time) for row in result}


async def _note_evidence_that_left(connection: AsyncConnection, ids: Sequence[int]) -> None:
    """Remember of denied changes that nothing they were about stands any more: then it may come again."""
    if ids:
        await connection.execute(
            text("""
            UPDATE changes c SET evidence_left = true
            WHERE id = ANY(CAST(:ids AS bigint[])) AND NOT evidence_left
              AND NOT EXISTS (SELECT FROM feature_states s WHERE s.feature_id = c.feature_id AND s.standing)
              AND NOT EXISTS (
                SELECT FROM candidates k WHERE k.id = c.candidate_id AND k.standing AND k.merged_into IS NULL)"""),
            {"ids": list(ids)},
        )
