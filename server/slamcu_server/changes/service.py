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
from slamcu_server.aggregation import reads
from slamcu_server.changes import repository
from slamcu_server.changes.belief import Kind
from slamcu_server.changes.explanation import Case, explain
from slamcu_server.changes.repository import FeedQuery, StoredChange
from slamcu_server.problems import Problem


def present(change_id: int, kind: str, state: str, revision: int, document: dict[str, Any]) -> dict[str, Any]:
    """Return the document of a change with what identifies it."""
    return {"id": change_id, "kind": kind, "state": state, "revision": revision, **document}


def present_change(change: StoredChange) -> dict[str, Any]:
    """Return the document of a change as it is now."""
    return present(change.id, change.kind.value, change.state.value, change.revision, change.document)


async def feed_page(
    connection: AsyncConnection, query: FeedQuery, parameters: Sequence[tuple[str, str]]
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
                "change": present(row.change_id, row.kind, row.state, row.revision, row.document),
            }
            for row in rows
        ],
        "next": following,
        "last_sequence": last,
    }


async def find_change(connection: AsyncConnection, change_id: int) -> StoredChange:
    """Return a change; answer 404 if there is none."""
    change = await repository.find_change(connection, change_id)
    if change is None:
        raise Problem(404, "unknown-change", f"there is no change {change_id}; GET /v1/changes lists those there are")
    return change


async def explain_change(connection: AsyncConnection, change: StoredChange) -> dict[str, Any]:
    """Return a change with the evidence behind it."""
    now = datetime.now(UTC)
    history = await repository.list_history(connection, change.id)
    return {
        **present_change(change),
        "evidence": explain(await _case(connection, change), change.salt, now),
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


async def _case(connection: AsyncConnection, change: StoredChange) -> Case:
    document = change.document
    policy = await repository.find_policy(connection, document["policy_version"]) or Policy()
    rules = policy.for_class(document["class"])
    lon, lat = document["geometry"]["coordinates"][:2]
    if change.kind is Kind.NEW and change.candidate_id is not None:
        passes = await reads.passes_over_candidate(connection, change.candidate_id)
        return Case(passes, Side.NEW, 0.0, rules, lon, lat)
    if change.feature_id is None:
        raise ValueError(f"change {change.id} is about nothing")
    by_feature = await reads.passes_over_features(connection, [change.feature_id])
    features = await reads.features(connection, [change.feature_id])
    prior = float(support(features[change.feature_id].existence_confidence))
    return Case(by_feature.get(change.feature_id, []), Side.DELETED, prior, rules, lon, lat)
