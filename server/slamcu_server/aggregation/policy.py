"""The aggregation policy in force: read at start, kept by its version."""

from __future__ import annotations

import json
from pathlib import Path

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy
from slamcu_core.errors import FormatError, SlamcuError
from slamcu_server.database.statements import text


def load_policy(path: Path | None) -> Policy:
    """Read a policy from a JSON file; None is the built-in one.

    Raises FormatError naming the file and what is wrong with it.
    """
    if path is None:
        return Policy()
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        return Policy.from_document(document)
    except (OSError, ValueError) as error:
        reason = str(error) if isinstance(error, SlamcuError) else f"cannot be read as a policy: {error}"
        raise FormatError(reason, source=str(path)) from error


async def remember_policy(connection: AsyncConnection, policy: Policy) -> None:
    """Keep a policy, so that what was said under it can be explained later."""
    await connection.execute(
        text("""
        INSERT INTO policies (version, document) VALUES (:version, CAST(:document AS jsonb))
        ON CONFLICT (version) DO NOTHING"""),
        {"version": policy.version, "document": json.dumps(policy.to_document())},
    )


async def count_outdated(connection: AsyncConnection, policy: Policy) -> int:
    """Return how many beliefs were folded under another policy: they are until they are touched or rebuilt."""
    result = await connection.execute(
        text("""
        SELECT (SELECT count(*) FROM feature_states WHERE policy_version <> :version)
             + (SELECT count(*) FROM candidates
                WHERE policy_version <> :version AND merged_into IS NULL AND feature_id IS NULL)"""),
        {"version": policy.version},
    )
    return int(result.scalar_one())
