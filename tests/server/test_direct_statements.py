"""Statements that the driver executes itself: the same transactions, rows and errors as SQLAlchemy's."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest
from sqlalchemy.exc import DBAPIError
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_server.aggregation.attempts import transient
from slamcu_server.database import direct
from slamcu_server.database.statements import text

pytestmark = pytest.mark.anyio

COUNT = text("SELECT count(*) FROM policies")
ADD = text("INSERT INTO policies (version, document) VALUES (:version, CAST(:document AS jsonb)) RETURNING version")
ONE = {"document": '{"a": 1}', "version": "one"}


async def test_rows_are_those_of_sqlalchemy(engine: AsyncEngine) -> None:
    query = text("SELECT n, n * :factor AS product, CAST(:word AS text) AS word FROM generate_series(1, :most) AS n")
    given = {"most": 3, "word": "a::b", "factor": 2}
    async with direct.begin(engine) as connection, engine.connect() as other:
        found, expected = await connection.execute(query, given), await other.execute(query, given)
        assert list(found.keys()) == list(expected.keys())
        assert [(row.n, row.product, row.word) for row in found] == [tuple(row) for row in expected]
        assert (await connection.execute(query, given | {"most": 0})).all() == []
        assert (await connection.execute(query, given | {"most": 0})).scalar_one_or_none() is None
        assert (await connection.execute(query, given | {"most": 1})).scalar_one() == 1
        assert (await connection.execute(query, given)).scalars().all() == [1, 2, 3]


async def test_all_or_nothing_is_committed(engine: AsyncEngine) -> None:
    with suppress(RuntimeError):
        async with direct.begin(engine) as connection:
            assert (await connection.execute(ADD, ONE)).scalar_one() == "one"
            raise RuntimeError
    async with direct.begin(engine) as connection:
        assert (await connection.execute(COUNT)).scalar_one() == 0
        await connection.execute(ADD, ONE)
    async with engine.connect() as connection:
        assert (await connection.execute(COUNT)).scalar_one() == 1


async def test_what_the_database_refuses_is_told_by_its_state(engine: AsyncEngine) -> None:
    async def add_twice() -> None:
        async with direct.begin(engine) as connection:
            await connection.execute(ADD, ONE)
            await connection.execute(ADD, ONE)

    with pytest.raises(DBAPIError) as refused:
        await add_twice()
    assert refused.value.orig.sqlstate == "23505"  # type: ignore[union-attr]  # the driver's error
    assert '{"a": 1}' not in str(refused.value)
    assert not transient(refused.value)
    async with direct.begin(engine) as connection:
        assert (await connection.execute(COUNT)).scalar_one() == 0


async def test_a_lost_connection_is_told_and_replaced(engine: AsyncEngine) -> None:
    async def lose() -> None:
        async with direct.begin(engine) as connection:
            pid = (await connection.execute(text("SELECT pg_backend_pid()"))).scalar_one()
            async with engine.connect() as other:
                await other.execute(text("SELECT pg_terminate_backend(:pid)"), {"pid": pid})
            await connection.execute(COUNT)

    with pytest.raises(Exception) as lost:  # noqa: PT011  (whatever says so)
        await lose()
    assert transient(lost.value)
    async with direct.begin(engine) as connection:
        assert (await connection.execute(COUNT)).scalar_one() == 0


async def test_work_that_is_cancelled_in_a_statement_leaves_nothing_not_even_a_lock_of_its_session(
    engine: AsyncEngine,
) -> None:
    async def work() -> None:
        async with direct.begin(engine) as connection:
            await connection.execute(ADD, ONE)
            await connection.execute(text("SELECT pg_advisory_lock(7), pg_sleep(60)"))

    async with engine.connect() as other:
        working = asyncio.create_task(work())
        held = text("SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND objid = 7 AND granted")
        async with asyncio.timeout(20):
            while not (await other.execute(held)).scalar_one():
                await other.execute(text("SELECT pg_sleep(0.01)"))
            working.cancel()
            with pytest.raises(asyncio.CancelledError):
                await working
            await other.execute(text("SELECT pg_advisory_lock(7)"))
            await other.execute(text("SELECT pg_advisory_unlock(7)"))
            assert (await other.execute(COUNT)).scalar_one() == 0
