"""The feed and the explanation of changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlencode

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy, Side
from slamcu_core.evidence import support
from slamcu_server.accounts.schemas import MapScope
from slamcu_server.accounts.times import TimesTold
from slamcu_server.aggregation import reads
from slamcu_server.aggregation.passes import StoredPass
from slamcu_server.changes import repository
from slamcu_server.changes.document import Document
from slamcu_server.changes.explanation import Case, explain
from slamcu_server.changes.repository import FeedQuery, StoredChange
from slamcu_server.problems import Problem
from slamcu_server.trust.table import trusting

_TIMES = ("first_seen", "last_seen", "last_looked", "first_evidence", "confirmed_at")  # of a document


def present(identity: dict[str, Any], document: Document, times: TimesTold) -> dict[str, Any]:
    """Return the document of a change with what identifies it, and its times as they are told."""
    halves = {name: _told(document[name], times) for name in ("from", "to") if document.get(name)}
    return {**identity, **_told(document, times), **halves}


def _told(document: Document, times: TimesTold) -> Document:
    return {**document, **{name: times.text(document[name]) for name in _TIMES if name in document}}


def present_change(change: StoredChange, times: TimesTold) -> dict[str, Any]:
    """Return the document of a change as it is now."""
    identity = {
        "id": change.id,
        "kind": change.kind.value,
        "state": change.state.value,
        "revision": change.revision,
    }
    return present(identity, change.document, times)


async def feed_page(
    connection: AsyncConnection, query: FeedQuery, parameters: Sequence[tuple[str, str]], times: TimesTold
) -> dict[str, Any]:
    """Return a page of the feed; `parameters` are those of the request that its `next` link repeats."""
    newest = await repository.last_sequence(connection)
    rows = await repository.list_entries(connection, replace(query, limit=query.limit + 1))
    more = len(rows) > query.limit
    rows = rows[: query.limit]
    last = rows[-1].sequence if more else max(newest, query.after)
    following = f"/v1/changes?{urlencode([*parameters, ('after', str(last))])}" if more else None
    return {
        "entries": [
            {
                "sequence": row.sequence,
                "said_at": row.created_at.isoformat(),
                "change": present(
                    {"id": row.change_id, "kind": row.kind, "state": row.state, "revision": row.revision},
                    row.document,
                    times,
                ),
            }
            for row in rows
        ],
        "next": following,
        "last_sequence": last,
    }


async def find_change(connection: AsyncConnection, scope: MapScope, change_id: int) -> StoredChange:
    """Return a change; answer 404 if there is none about a map of the scope."""
    change = await repository.find_change(connection, change_id)
    if change is None or change.map_source not in scope:
        raise Problem(404, "unknown-change", f"there is no change {change_id}; GET /v1/changes lists those there are")
    return change


async def explain_change(
    connection: AsyncConnection, change: StoredChange, times: TimesTold, as_of: datetime | None = None
) -> dict[str, Any]:
    """Return a change with the evidence behind it, as of a time (now, if none is given)."""
    now = datetime.now(UTC) if as_of is None else times.until(as_of)
    history = await repository.list_history(connection, change.id)
    explained = [explain(case, change.salt, now, times) for case in await _cases(connection, change)]
    return {
        **present_change(change, times),
        "evidence": explained[0],
        "evidence_from": explained[1] if len(explained) > 1 else None,
        "history": [
            {
                "sequence": row.sequence,
                "said_at": row.created_at.isoformat(),
                "state": row.state,
                "revision": row.revision,
            }
            for row in history
        ],
    }


async def _cases(connection: AsyncConnection, change: StoredChange) -> list[Case]:
    """Return the evidence about a change: about the candidate first, where there is one, then about the map feature."""
    document = change.document
    policy = await repository.find_policy(connection, document["policy_version"]) or Policy()
    rules = (await trusting(connection, policy)).for_class(document["class"])
    cases: list[Case] = []
    if change.candidate_id is not None:
        passes = await reads.passes_over_candidate(connection, change.candidate_id)
        cases.append(Case(passes, Side.NEW, 0.0, rules, *_place(document.get("to") or document)))
    if change.feature_id is not None:
        passes = await _passes_over_feature(connection, change, change.feature_id)
        feature = (await reads.features(connection, [change.feature_id]))[change.feature_id]
        prior = float(support(feature.existence_confidence))
        cases.append(Case(passes, Side.DELETED, prior, rules, *_place(document.get("from") or document)))
    if not cases:
        raise ValueError(f"change {change.id} is about nothing")
    return cases


async def _passes_over_feature(connection: AsyncConnection, change: StoredChange, feature_id: int) -> list[StoredPass]:
    """Return the passes that speak about a feature as it is, or as it was before the map took up the change."""
    version = change.document.get("mapped_in")
    if version is None:
        return (await reads.passes_over_features(connection, [feature_id])).get(feature_id, [])
    return await reads.passes_over_feature_before(connection, feature_id, version)


def _place(document: dict[str, Any]) -> tuple[float, float, tuple[float, float, float]]:
    lon, lat = document["geometry"]["coordinates"][:2]
    xx, xy, yy = document["covariance_m2"]
    return lon, lat, (xx, xy, yy)
