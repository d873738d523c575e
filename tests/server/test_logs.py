"""The log names errors, and never what a vehicle reported."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import encode_batch
from slamcu_server.aggregation.worker import fuse_pending
from slamcu_server.database.transactions import WriteTransaction
from slamcu_server.logs import DiscreetFormatter, told

pytestmark = pytest.mark.anyio

MakeReport = Callable[..., ReportMessage]
SECRET = "drive-to-the-doctor"


@pytest.fixture
def log(caplog: pytest.LogCaptureFixture) -> pytest.LogCaptureFixture:
    """The log as a server writes it."""
    caplog.handler.setFormatter(DiscreetFormatter("%(levelname)s %(message)s"))
    caplog.set_level(logging.INFO)
    return caplog


async def post(client: httpx.AsyncClient, vehicle: dict[str, str], report: ReportMessage) -> httpx.Response:
    headers = vehicle | {"Content-Type": "application/x-protobuf"}
    return await client.post("/v1/data-messages", content=encode_batch([report]), headers=headers)


async def test_a_lost_connection_tells_no_parameters(
    *,
    client: httpx.AsyncClient,
    vehicle: dict[str, str],
    town: MapIdentity,
    make_report: MakeReport,
    engine: AsyncEngine,
    log: pytest.LogCaptureFixture,
) -> None:
    waits = text("SELECT pid FROM pg_locks WHERE NOT granted AND relation = CAST('messages' AS regclass)")
    async with engine.begin() as connection:
        await connection.execute(text("LOCK messages"))
        posting = asyncio.create_task(post(client, vehicle, make_report(session_id=SECRET)))
        while (pid := await connection.scalar(waits)) is None:  # noqa: ASYNC110  (the database's state, no event of ours)
            await asyncio.sleep(0.02)
        await connection.execute(text("SELECT pg_terminate_backend(:pid)"), {"pid": pid})
        assert (await posting).status_code == 503
    assert re.search(r"the database did not answer: \w+Error \(SQLSTATE (57P01|08003)\)", log.text)
    assert SECRET not in log.text


@pytest.mark.parametrize(
    ("statement", "status", "named"),
    [
        ("SELECT CAST(CAST(:secret AS text) AS int)", 422, "InvalidTextRepresentationError (SQLSTATE 22P02)"),
        ("SELECT CAST(:secret AS bigint)", 422, "DataError"),
        (
            "INSERT INTO accounts (role, label) VALUES ('vehicle', :secret), ('vehicle', :secret)", 500,
            "UniqueViolationError (SQLSTATE 23505, constraint ",
        ),
    ],
)  # fmt: skip
async def test_what_the_database_quotes_is_not_told(
    *,
    app: FastAPI,
    client: httpx.AsyncClient,
    log: pytest.LogCaptureFixture,
    statement: str,
    status: int,
    named: str,
) -> None:
    async def ask(connection: Any) -> None:
        await connection.execute(text(statement), {"secret": SECRET})

    ask.__annotations__ = {"connection": WriteTransaction, "return": None}
    app.get("/ask")(ask)
    assert (await client.get("/ask")).status_code == status
    assert named in log.text
    assert SECRET not in log.text
    if status == 500:
        assert "in ask\n" in log.text  # where it happened


async def test_a_message_that_is_put_aside_is_not_quoted(
    *,
    client: httpx.AsyncClient,
    vehicle: dict[str, str],
    town: MapIdentity,
    make_report: MakeReport,
    engine: AsyncEngine,
    log: pytest.LogCaptureFixture,
) -> None:
    async with engine.begin() as connection:
        await connection.execute(
            text(f"""
            CREATE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
                RAISE check_violation USING MESSAGE = 'no {SECRET}', DETAIL = 'Failing row contains ({SECRET}).';
            END $$""")
        )
        await connection.execute(
            text("CREATE TRIGGER refuse BEFORE INSERT ON passes FOR EACH ROW EXECUTE FUNCTION refuse()")
        )
    assert (await post(client, vehicle, make_report(session_id=SECRET))).status_code == 202
    assert (await fuse_pending(engine, Policy())).quarantined == 1
    async with engine.connect() as connection:
        reason = await connection.scalar(text("SELECT error FROM messages"))
    assert reason == "CheckViolationError (SQLSTATE 23514)"
    assert "is put aside" in log.text
    assert SECRET not in log.text


def test_other_errors_are_told_with_all_that_they_came_from() -> None:
    def broken() -> None:
        try:
            {}["kitchen"]
        except KeyError as error:
            raise ExceptionGroup("two", [ValueError("one"), ValueError("other")]) from error

    with pytest.raises(ExceptionGroup) as raised:
        broken()
    written = DiscreetFormatter().formatException((raised.type, raised.value, raised.tb))
    places = [written.index(each) for each in ("KeyError: 'kitchen'", "ExceptionGroup: two", "ValueError: other")]
    assert places == sorted(places)
    assert told(ConnectionRefusedError("nobody at 5432")) == "ConnectionRefusedError: nobody at 5432"
