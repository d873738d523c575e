"""Recompute trust: judge what is stored, make the next version, gate sessions, and list what has to be folded again."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import (
    About,
    Tally,
    Testimony,
    Verdict,
    has_record,
    is_gated,
    judge,
    tally,
    trust_share,
)
from slamcu_server.aggregation import log
from slamcu_server.retraction import marks, repository
from slamcu_server.retraction.filter import EvidenceFilter
from slamcu_server.trust import table, testimonies
from slamcu_server.trust.table import Standing

WINDOW = timedelta(days=90)
"""How far back a record reaches: what a car did long ago, with another camera perhaps, is forgiven."""

_LOCK = 3  # of the job; 2 is that of retractions
GATE_REASON = "the server: most of what this session reports is contradicted by other vehicles"

Session = tuple[int, str]  # contributor, session id


@dataclass(frozen=True, slots=True)
class Recomputed:
    """What a run of the job found and changed."""

    version: int | None  # the version that holds now; None: nothing has been judged yet
    judged: int  # verdicts
    contributors: Mapping[int, Standing]  # those whose standing has changed
    gated: tuple[Session, ...]
    released: tuple[Session, ...]

    @property
    def changed(self) -> bool:
        """Whether anything has to be folded again."""
        return bool(self.contributors or self.gated or self.released)


async def recompute(engine: AsyncEngine, now: datetime | None = None) -> Recomputed | None:
    """Recompute trust from the stored passes; None if another process is at it."""
    async with engine.begin() as connection:
        alone = await connection.execute(text("SELECT pg_try_advisory_xact_lock(:key)"), {"key": _LOCK})
        if not alone.scalar_one():
            return None
        verdicts, newest = await _verdicts(connection, (now or datetime.now(UTC)) - WINDOW)
        return await _write(connection, verdicts, datetime.fromtimestamp(newest, UTC))


async def _verdicts(connection: AsyncConnection, since: datetime) -> tuple[list[Verdict], float]:
    """Return all verdicts, and the time of the newest testimony, s of POSIX time."""
    found: list[Verdict] = []
    newest = 0.0
    for about in About:
        async for things in testimonies.read(connection, about, since):
            newest = max([newest, *(item.time for said in things for item in said)])
            found += await asyncio.to_thread(_judge, things, about)
    return found, newest


def _judge(things: Iterable[list[Testimony]], about: About) -> list[Verdict]:
    return [verdict for said in things for verdict in judge(said, about)]


async def _write(connection: AsyncConnection, verdicts: list[Verdict], newest: datetime) -> Recomputed:
    of_contributor: defaultdict[int, list[Verdict]] = defaultdict(list)
    of_session: defaultdict[Session, list[Verdict]] = defaultdict(list)
    for one in verdicts:
        of_contributor[one.testimony.contributor].append(one)
        of_session[one.testimony.contributor, one.testimony.session].append(one)
    sessions = {key: tally(mine) for key, mine in of_session.items()}

    await marks.hold_alone(connection)
    version = await table.newest_version(connection)
    before = await table.current(connection)
    wanted = {key: _standing(tally(mine), before.get(key, Standing()), newest) for key, mine in of_contributor.items()}
    changed = {
        key: wanted.get(key, Standing())
        for key in sorted(wanted.keys() | before.keys())
        if _differs(wanted.get(key, Standing()), before.get(key, Standing()))
    }
    if verdicts and (version is None or changed):
        await _list_passes(connection, changed)
        version = await table.write_version(connection, len(verdicts), changed)
    gated, released = await _gate(connection, sessions)
    await log.call(connection)
    return Recomputed(version, len(verdicts), changed, gated, released)


def _standing(counted: Tally, before: Standing, newest: datetime) -> Standing:
    """Return what a tally is worth: a record that is new counts for what is said from now on, not for what was."""
    proven = has_record(counted)
    since = None if not proven else before.proven_since if before.proven else newest
    return Standing(trust_share(counted), proven, since, counted)


def _differs(one: Standing, other: Standing) -> bool:
    return one.proven != other.proven or abs(one.share - other.share) > 1e-9


async def _list_passes(connection: AsyncConnection, contributors: Iterable[int]) -> None:
    """List for correction one pass of each thing that contributors have spoken about."""
    await connection.execute(
        text("""
        INSERT INTO corrections (pass_id)
        SELECT min(p.id) FROM messages m JOIN passes p ON p.message = m.id
        WHERE m.account_id = ANY(CAST(:ids AS bigint[])) AND NOT p.archived AND p.retraction_id IS NULL
          AND (p.feature_id IS NOT NULL OR p.candidate_id IS NOT NULL)
        GROUP BY p.feature_id, p.candidate_id ORDER BY 1"""),
        {"ids": sorted(contributors)},
    )


async def _gate(
    connection: AsyncConnection, sessions: Mapping[Session, Tally]
) -> tuple[tuple[Session, ...], tuple[Session, ...]]:
    """Take out the sessions that contradict the others, and let in again those that do so no longer."""
    standing = await repository.list_gates(connection)
    gated = sorted(key for key, counted in sessions.items() if is_gated(counted) and key not in standing)
    # What a gated session found is part of nothing, so its finds are not judged any more: doubt keeps it out.
    released = sorted(
        key
        for key in standing
        if key in sessions and sessions[key].judged > 0 and sessions[key].right > 2 * sessions[key].wrong
    )
    for contributor, session in gated:
        names = EvidenceFilter(contributor_id=contributor, session_id=session)
        await repository.add(connection, names, GATE_REASON, None)
    for key in released:
        await repository.request_undo(connection, standing[key], "the server: other vehicles have come to agree", None)
    return tuple(gated), tuple(released)
