"""A map feature with what is believed about it now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlencode

from sqlalchemy import Row
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy, kept_at
from slamcu_core.evidence import support
from slamcu_server.accounts.schemas import MapScope, Principal
from slamcu_server.accounts.times import TimesTold
from slamcu_server.changes.document import evidence, timestamp
from slamcu_server.changes.repository import find_policy
from slamcu_server.features import repository
from slamcu_server.features.repository import LookQuery
from slamcu_server.maps.service import find_version
from slamcu_server.problems import Problem


async def find_feature(connection: AsyncConnection, reader: Principal, feature_id: int) -> dict[str, Any]:
    """Return the document of a feature; answer 404 if there is none in the reader's scope."""
    row = await repository.find_feature(connection, feature_id)
    if row is None or row.source not in reader.scope:
        raise Problem(404, "unknown-feature", f"there is no feature {feature_id}")
    policy = None if row.state_of is None else await find_policy(connection, row.policy_version)
    versions = await repository.list_versions(connection, feature_id)
    changes = await repository.list_changes(connection, feature_id)
    return {
        "id": row.id,
        "map": row.source,
        "object_id": row.object_id,
        "in_map": row.to_sequence is None,
        "standing": _standing(row, policy or Policy(), datetime.now(UTC), reader.times),
        "versions": [_version(version) for version in versions],
        "changes": [{"id": change.id, "kind": change.kind, "state": change.state} for change in changes],
    }


async def look_page(
    connection: AsyncConnection, query: LookQuery, parameters: Sequence[tuple[str, str]], times: TimesTold
) -> dict[str, Any]:
    """Return a page of features with when they were looked at; answer 404 if there is no such map."""
    await find_version(connection, query.scope, query.map_source)
    rows = await repository.list_looks(connection, replace(query, limit=query.limit + 1))
    now = datetime.now(UTC)
    page = rows[: query.limit]
    following = None
    if len(rows) > query.limit:
        following = f"/v1/features?{urlencode([*parameters, ('after', str(page[-1].id))])}"
    return {
        "features": [
            {
                "id": row.id,
                "object_id": row.object_id,
                "class": row.feature_class,
                "sign": row.sign,
                "value": row.value,
                "geometry": {"type": "Point", "coordinates": [row.lon, row.lat]},
                "last_looked": times.text(row.last_looked),
                "last_seen": times.text(row.last_seen),
                "looked": row.looked,
                "could_not_see": row.could_not_see,
                "stands_against": row.stands_against and (row.fades_at is None or now < row.fades_at),
            }
            for row in page
        ],
        "next": following,
    }


async def find_id(connection: AsyncConnection, scope: MapScope, source: str, object_id: int) -> int:
    """Return the id of the feature that a map of the scope calls `object_id`; answer 404 if there is none."""
    may_be = source in scope and source.isprintable()
    found = await repository.find_id(connection, source, object_id) if may_be else None
    if found is None:
        raise Problem(404, "unknown-feature", f"map {source[:200]!r} never had a feature {object_id}")
    return found


def _standing(row: Row[Any], policy: Policy, as_of: datetime, times: TimesTold) -> dict[str, Any]:
    if row.state_of is None:
        prior = float(support(row.existence_confidence))
        return {"as_of": timestamp(as_of), **evidence(prior, 0.0), **_NOBODY}
    rules = policy.for_class(row.feature_class)
    # decayed from the time that is told: how much is left would tell the other one
    last = None if row.last_informative is None else times.round(row.last_informative).timestamp()
    kept = kept_at(last, as_of.timestamp(), rules)
    return {
        "as_of": timestamp(as_of),
        **evidence(kept * row.weight_for, kept * row.weight_against),
        "stands_against": _stands(row, as_of),
        "contributors_for": row.contributors_for,
        "contributors_against": row.contributors_against,
        "passes": row.passes,
        "looked": row.looked,
        "blocked": row.blocked,
        "looked_ever": row.looked + row.forgotten_looked,
        "could_not_see_ever": row.blocked + row.forgotten_blocked,
        "last_looked": times.text(row.last_looked),
        "last_seen": times.text(row.last_seen),
        "policy_version": row.policy_version,
    }


def _stands(row: Row[Any], as_of: datetime) -> bool:
    """Whether a feature is believed to be gone, and that has not faded."""
    return bool(row.standing) and (row.fades_at is None or as_of < row.fades_at)


_NOBODY: dict[str, Any] = {
    "stands_against": False,
    "contributors_for": 0,
    "contributors_against": 0,
    "passes": 0,
    "looked": 0,
    "blocked": 0,
    "looked_ever": 0,
    "could_not_see_ever": 0,
    "last_looked": None,
    "last_seen": None,
    "policy_version": None,
}


def _version(row: Row[Any]) -> dict[str, Any]:
    place = [row.lon, row.lat] if row.altitude is None else [row.lon, row.lat, row.altitude]
    return {
        "since": row.since,
        "until": row.until,
        "class": row.feature_class,
        "sign": row.sign,
        "value": row.value,
        "geometry": {"type": "Point", "coordinates": place},
        "heading_deg": row.heading_deg,
        "existence_confidence": row.existence_confidence,
        "position_std_m": row.position_std_m,
    }
