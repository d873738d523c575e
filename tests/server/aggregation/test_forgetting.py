"""In the end a message leaves nothing but digests behind, by which it is still taken once."""

from __future__ import annotations

import asyncio
from datetime import timedelta
from typing import Any

import asyncpg
import pytest
from sqlalchemy import event, text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_server.aggregation import forgetting
from slamcu_server.aggregation.forgetting import forget_messages
from slamcu_server.aggregation.worker import forget_bodies
from slamcu_server.ingest.message_log import LogEntry, Outcome, PostgresMessageLog

pytestmark = pytest.mark.anyio

NOW = timedelta(0)
ACCEPTED, DUPLICATE, CONFLICT = Outcome.ACCEPTED, Outcome.DUPLICATE, Outcome.CONFLICT


async def append(engine: AsyncEngine, account: int, *entries: LogEntry) -> list[Outcome]:
    async with engine.begin() as connection:
        return await PostgresMessageLog(connection).append(account, entries)


async def forget(engine: AsyncEngine) -> int:
    await forget_bodies(engine, NOW)
    return await forget_messages(engine, NOW, pause=NOW)


async def sent(town: Any, count: int, body: bytes = b"x") -> tuple[int, list[LogEntry]]:
    """Messages that were fused and of which no pass is kept, and the account that sent them."""
    account = await town.account("van")
    entries = [LogEntry("s", number, body) for number in range(1, count + 1)]
    assert await append(town.engine, account, *entries) == [ACCEPTED] * count
    await town.do("UPDATE messages SET state = 'fused', processed_at = now() WHERE account_id = :a", a=account)
    return account, entries


async def test_what_is_forgotten_is_still_taken_once(town: Any) -> None:
    account, entries = await sent(town, 3)
    assert await forget(town.engine) == 3
    assert await town.scalar("SELECT count(*) FROM messages") == 0
    assert await append(town.engine, account, *entries) == [DUPLICATE] * 3
    other = [LogEntry("s", 2, b"y"), LogEntry("s", 2, b"x"), LogEntry("s", 4, b"x"), LogEntry("t", 2, b"y")]
    assert await append(town.engine, account, *other) == [CONFLICT, DUPLICATE, ACCEPTED, ACCEPTED]
    assert await append(town.engine, await town.account("another"), entries[0]) == [ACCEPTED]
    assert await town.scalar("SELECT count(*) FROM messages WHERE state = 'pending'") == 3


async def test_nothing_of_who_and_when_is_left(town: Any) -> None:
    await sent(town, 3)
    await forget(town.engine)
    rows = await town.rows("SELECT to_jsonb(f) AS row FROM forgotten_messages f")
    assert [set(row.row) for row in rows] == [{"ids", "content"}] * 3
    assert {len(row.row[name]) for row in rows for name in ("ids", "content")} == {2 + 2 * 16}  # \\x and digits
    assert len({row.row["content"] for row in rows}) == 1, "the same bytes"
    # Another database's digests of the same are others.
    before = await town.scalar(f"SELECT {forgetting.ids_digest('1', chr(39) + 's' + chr(39), '1::bigint')}")
    await town.do("UPDATE forgetting SET key = sha256(key)")
    assert await town.scalar(f"SELECT {forgetting.ids_digest('1', chr(39) + 's' + chr(39), '1::bigint')}") != before


async def test_only_what_is_fused_and_old_and_of_no_pass_is_forgotten(town: Any, reports: Any) -> None:
    await town.report("a", reports.missed(1, hours=0))  # a pass is kept of it
    await town.fuse()
    await town.report("b", reports.missed(1, hours=0))  # waits
    await sent(town, 1)
    await town.do("UPDATE messages SET state = 'quarantined' WHERE account_id = :a", a=await town.account("van"))
    assert await forget(town.engine) == 0
    await town.fuse()
    await town.do("UPDATE messages SET state = 'fused' WHERE state = 'quarantined'")
    assert await forget_messages(town.engine, NOW, pause=NOW) == 0, "its body is kept"
    await forget_bodies(town.engine, NOW)
    assert await forget_messages(town.engine, timedelta(days=1), pause=NOW) == 0
    assert await forget_messages(town.engine, NOW) == 0, "somebody has swept within the hour"
    assert await forget_messages(town.engine, NOW, pause=NOW) == 1
    assert await town.scalar("SELECT count(*) FROM messages") == 2
    await town.do("DELETE FROM passes")
    assert await forget_messages(town.engine, NOW, pause=NOW) == 2


async def test_a_sweep_goes_on_where_the_one_before_stopped(town: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forgetting, "_SLICE", 4)
    monkeypatch.setattr(forgetting, "_SLICES", 2)
    account, entries = await sent(town, 30)
    assert [await forget(town.engine) for _ in range(5)] == [8, 8, 8, 6, 0]
    assert await append(town.engine, account, *entries) == [DUPLICATE] * 30


async def test_who_takes_messages_while_others_are_forgotten_knows_them(
    town: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forgetting, "_SLICE", 5)
    account, entries = await sent(town, 400)
    await forget_bodies(town.engine, NOW)
    forgotten = asyncio.create_task(forget_messages(town.engine, NOW, pause=NOW))
    outcomes: set[Outcome] = set()
    rounds = 0
    while not forgotten.done() or rounds < 3:
        for batch in (entries[:200], entries[200:], entries[::7]):
            outcomes |= set(await append(town.engine, account, *batch))
        rounds += 1
    while await forget_messages(town.engine, NOW, pause=NOW):
        pass
    assert outcomes == {DUPLICATE}
    assert await town.scalar("SELECT count(*) FROM messages") == 0
    assert await town.scalar("SELECT count(*) FROM forgotten_messages") == 400


async def test_it_waits_for_nobody_who_holds_the_table(town: Any) -> None:
    """A backup reads for hours; whoever would wait for it would hold up all who report."""
    account, entries = await sent(town, 2)
    async with town.engine.connect() as backup:
        await backup.execute(text("SELECT count(*) FROM forgotten_messages"))
        assert await forget(town.engine) == 0
        assert await append(town.engine, account, *entries) == [DUPLICATE] * 2
    assert await forget(town.engine) == 2


async def test_a_batch_of_reports_probes_what_is_forgotten_by_its_index(town: Any) -> None:
    await town.do("""
        INSERT INTO forgotten_messages
        SELECT substr(sha256(int8send(n)), 1, 16), '' FROM generate_series(1, 50000) n""")
    account, entries = await sent(town, 1000)
    await town.do("ANALYZE")
    asked: list[tuple[str, Any]] = []
    event.listen(
        town.engine.sync_engine,
        "before_cursor_execute",
        lambda _connection, _cursor, statement, parameters, *_: asked.append((statement, parameters)),
    )
    await append(town.engine, account, *entries[:500], *(LogEntry("new", number, b"x") for number in range(500)))
    about = [(statement, parameters) for statement, parameters in asked if "forgotten_messages" in statement]
    connection = await asyncpg.connect(town.engine.url.render_as_string(False).replace("+asyncpg", ""))
    try:
        plans = [
            "\n".join(line[0] for line in await connection.fetch(f"EXPLAIN {statement}", *parameters))
            for statement, parameters in about
        ]
    finally:
        await connection.close()
    assert len(plans) == 2  # to take what is new, and to compare what is not
    for plan in plans:
        assert "Index" in plan
        assert "Seq Scan on forgotten_messages" not in plan, plan
        assert "Seq Scan on messages" not in plan, plan
