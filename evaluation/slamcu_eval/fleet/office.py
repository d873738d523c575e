"""What the operator of an evaluation's server does beside it: imports a map, hands out keys.

It is what `slamcu-server import-map` and `create-key` do, without the start of a process for each.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.aggregation import Policy
from slamcu_server.accounts.schemas import Role
from slamcu_server.accounts.service import create_account
from slamcu_server.changes.rebase import import_and_rebase
from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.engine import create_engine

T = TypeVar("T")


def import_map(data_dir: Path, policy: Policy, path: Path) -> None:
    """Import an HD map (GeoJSON); raises SlamcuError if the file cannot be used."""
    _in_transaction(data_dir, lambda connection: import_and_rebase(connection, policy, path))


def create_keys(data_dir: Path, role: str, labels: list[str]) -> list[str]:
    """Make an account for each label, and return their keys."""

    async def work(connection: AsyncConnection) -> list[str]:
        return [(await create_account(connection, Role(role), label)).key for label in labels]

    return _in_transaction(data_dir, work)


def _in_transaction(data_dir: Path, work: Callable[[AsyncConnection], Awaitable[T]]) -> T:
    async def run(url: str) -> T:
        engine = create_engine(url, application_name="slamcu-eval")
        try:
            async with engine.begin() as connection:
                return await work(connection)
        finally:
            await engine.dispose()

    with EmbeddedCluster(data_dir) as cluster:
        return asyncio.run(run(cluster.url))
