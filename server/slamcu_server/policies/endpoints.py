"""GET /v1/policies and GET /v1/policies/{version}."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request
from sqlalchemy import select

from slamcu_server.accounts.authentication import Provider
from slamcu_server.aggregation.policy import load_policy
from slamcu_server.database.tables import policies
from slamcu_server.database.transactions import ReadTransaction
from slamcu_server.policies.schemas import PolicyList, PolicySummary, PolicyVersion
from slamcu_server.problems import Problem, responses

router = APIRouter(prefix="/v1/policies", tags=["changes"], responses=responses(401, 403))


@router.get("")
async def get_policies(request: Request, _: Provider, connection: ReadTransaction) -> PolicyList:
    """List the policies under which this server has aggregated, oldest first, and which is in force here."""
    columns = policies.c
    rows = await connection.execute(select(columns.version, columns.created_at).order_by(columns.created_at))
    return PolicyList(
        in_force=load_policy(request.app.state.settings.policy_file).version,
        policies=[PolicySummary(version=row.version, since=row.created_at) for row in rows],
    )


@router.get("/{version}", responses=responses(404))
async def get_policy(
    _: Provider,
    connection: ReadTransaction,
    version: Annotated[str, Path(pattern="^[0-9a-f]{12}$", description="The `policy_version` of a change.")],
) -> PolicyVersion:
    """Read a policy: what it takes to confirm or withdraw a change, for each class of features.

    Its version is a digest of it, so that a policy never changes under its version.
    """
    row = (await connection.execute(select(policies).where(policies.c.version == version))).one_or_none()
    if row is None:
        raise Problem(404, "unknown-policy", f"no change was ever decided under a policy {version}")
    return PolicyVersion(version=row.version, since=row.created_at, document=row.document)
