"""Fleets on a short road, and a look into the database that they report to."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import pytest
from sqlalchemy import text

from slamcu_core.aggregation import Policy
from slamcu_eval.fleet import Cloud
from slamcu_server.aggregation.rebuild import differences
from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.engine import create_engine


@dataclass(frozen=True)
class Stored:
    """What the database holds after a fleet has reported."""

    messages: Counter[tuple[str, int]]  # how often each (session, message id) is in the log
    states: Counter[str]  # of the messages
    passes: int
    contributors: int
    differences: list[str]  # between what is believed and the fold of the stored passes


@pytest.fixture
def look_into() -> Callable[[Cloud], Stored]:
    """Read the database of a cloud that is running."""

    async def read(url: str) -> Stored:
        engine = create_engine(url, application_name="slamcu-test")
        try:
            async with engine.connect() as connection:
                log = (await connection.execute(text("SELECT session_id, message_id, state FROM messages"))).all()
                query = "SELECT count(*), count(DISTINCT contributor_id) FROM passes"
                passes, contributors = (await connection.execute(text(query))).one()
            return Stored(
                messages=Counter((row.session_id, row.message_id) for row in log),
                states=Counter(row.state for row in log),
                passes=passes,
                contributors=contributors,
                differences=await differences(engine, Policy()),
            )
        finally:
            await engine.dispose()

    def look(cloud: Cloud) -> Stored:
        with EmbeddedCluster(cloud.data_dir) as cluster:
            return asyncio.run(read(cluster.url))

    return look
