"""The trust table: one version holds at a time, and every version can be had again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy, Tally, Trusts
from slamcu_server.aggregation.bulk import arrays, unnest
from slamcu_server.database.statements import text

_loaded: WeakKeyDictionary[Any, Trusts] = WeakKeyDictionary()
"""The newest version that this process has read, by database."""

_TYPES = {
    "contributor_id": "bigint",
    "share": "float8",
    "proven": "boolean",
    "proven_since": "timestamptz",
    "right_count": "integer",
    "wrong_count": "integer",
    "right_claims": "integer",
    "wrong_claims": "integer",
}


@dataclass(frozen=True, slots=True)
class Standing:
    """What a contributor is worth."""

    share: float = 1.0  # of the policy's α
    proven: bool = False
    proven_since: datetime | None = None  # event time; None: always, if proven
    counted: Tally = field(default_factory=Tally)


async def trusting(connection: AsyncConnection, policy: Policy) -> Policy:
    """Return the policy with the trust version that holds; before the first nobody has a record.

    Who folds holds the ground first (`retraction.marks.hold`), so that the version cannot change meanwhile.
    """
    version = await newest_version(connection)
    if version is None:
        return policy.trusting(Trusts())
    key = connection.sync_connection.engine if connection.sync_connection is not None else None
    known = _loaded.get(key) if key is not None else None
    if known is None or known.version != version:
        known = await load(connection, version)
        if key is not None:
            _loaded[key] = known
    return policy.trusting(known)


async def newest_version(connection: AsyncConnection) -> int | None:
    """Return the version that holds; None before the first."""
    version: int | None = (
        await connection.execute(text("SELECT version FROM trust_versions ORDER BY version DESC LIMIT 1"))
    ).scalar_one_or_none()
    return version


async def current(connection: AsyncConnection) -> dict[int, Standing]:
    """Return what the table says now about each contributor that is in it."""
    found = await connection.execute(text("SELECT * FROM trust WHERE to_version IS NULL"))
    return {
        row.contributor_id: Standing(
            row.share,
            row.proven,
            row.proven_since,
            Tally(row.right_count, row.wrong_count, row.right_claims, row.wrong_claims),
        )
        for row in found
    }


async def write_version(connection: AsyncConnection, judged: int, changed: Mapping[int, Standing]) -> int:
    """Make the next version, which says something else about some contributors."""
    version = int(
        (
            await connection.execute(
                text("INSERT INTO trust_versions (judged) VALUES (:judged) RETURNING version"), {"judged": judged}
            )
        ).scalar_one()
    )
    await connection.execute(
        text("""
        UPDATE trust SET to_version = :version
        WHERE to_version IS NULL AND contributor_id = ANY(CAST(:ids AS bigint[]))"""),
        {"version": version, "ids": sorted(changed)},
    )
    rows = [
        {
            "contributor_id": key,
            "share": changed[key].share,
            "proven": changed[key].proven,
            "proven_since": changed[key].proven_since,
            "right_count": changed[key].counted.right,
            "wrong_count": changed[key].counted.wrong,
            "right_claims": changed[key].counted.right_claims,
            "wrong_claims": changed[key].counted.wrong_claims,
        }
        for key in sorted(changed)
    ]
    columns = ", ".join(_TYPES)
    await connection.execute(
        text(f"INSERT INTO trust ({columns}, from_version) SELECT {columns}, :version FROM {unnest(_TYPES)}"),  # noqa: S608
        {**arrays(_TYPES, rows), "version": version},
    )
    return version


async def load(connection: AsyncConnection, version: int) -> Trusts:
    """Return one version of the table."""
    found = list(
        await connection.execute(
            text("""
            SELECT contributor_id, share,
                   CASE WHEN NOT proven THEN 'infinity'
                        ELSE COALESCE(extract(epoch FROM proven_since)::float8, '-infinity') END AS proven_since
            FROM trust
            WHERE from_version <= :version AND (to_version IS NULL OR to_version > :version)
            ORDER BY contributor_id"""),
            {"version": version},
        )
    )
    return Trusts(
        version,
        np.array([row.contributor_id for row in found], np.int64),
        np.array([row.share for row in found], float),
        np.array([row.proven_since for row in found], float),
    )
