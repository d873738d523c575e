"""What any message log promises, whatever it is kept in."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DBAPIError
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_server.aggregation import log as worker_log
from slamcu_server.aggregation.locks import turn
from slamcu_server.aggregation.log import ClaimedMessage
from slamcu_server.ingest.message_log import LogEntry, MessageLog, Outcome, PostgresMessageLog

pytestmark = pytest.mark.anyio

OpenLog = Callable[[], AbstractAsyncContextManager[MessageLog]]
ACCEPTED, DUPLICATE, CONFLICT = Outcome.ACCEPTED, Outcome.DUPLICATE, Outcome.CONFLICT


class StopError(Exception):
    """Makes a unit of work fail."""


@pytest.fixture
async def accounts(engine: AsyncEngine) -> list[int]:
    async with engine.begin() as connection:
        query = text("INSERT INTO accounts (role, label) VALUES ('vehicle', 'a'), ('vehicle', 'b') RETURNING id")
        return list((await connection.execute(query)).scalars())


@pytest.fixture(params=["postgres"])
def open_log(engine: AsyncEngine) -> OpenLog:
    """`async with open_log() as log`: one unit of work, which has its effect at its end, or none if it fails."""

    @asynccontextmanager
    async def open_postgres() -> AsyncIterator[MessageLog]:
        async with engine.begin() as connection:
            yield PostgresMessageLog(connection)

    return open_postgres


def entry(number: int, body: bytes = b"x", session: str = "s") -> LogEntry:
    return LogEntry(session, number, body)


async def append(open_log: OpenLog, account: int, *entries: LogEntry) -> list[Outcome]:
    async with open_log() as log:
        return await log.append(account, entries)


async def pending(open_log: OpenLog) -> list[int]:
    """The message ids that a worker would get; they stay pending."""
    found: list[int] = []
    with suppress(StopError):
        async with open_log() as log:
            found += [message.message_id for message in await log.claim(1000)]
            raise StopError
    return found


async def test_each_message_of_an_account_is_taken_once(open_log: OpenLog, accounts: list[int]) -> None:
    one, other = accounts
    assert await append(open_log, one, entry(1), entry(2)) == [ACCEPTED, ACCEPTED]
    assert await append(open_log, one, entry(2), entry(3)) == [DUPLICATE, ACCEPTED]
    assert await append(open_log, one, entry(3, b"y"), entry(4)) == [CONFLICT, ACCEPTED]
    assert await append(open_log, one, entry(5), entry(5), entry(5, b"y")) == [ACCEPTED, DUPLICATE, CONFLICT]
    assert await append(open_log, one, entry(1, session="t")) == [ACCEPTED]
    assert await append(open_log, other, entry(1, b"y")) == [ACCEPTED]
    assert await append(open_log, one) == []


async def test_it_is_a_set_whatever_the_batches(open_log: OpenLog, accounts: list[int]) -> None:
    rng = random.Random(7)
    model: dict[tuple[int, str, int], bytes] = {}
    for _ in range(40):
        account = rng.choice(accounts)
        batch = [
            LogEntry(rng.choice("st"), rng.randint(1, 12), rng.choice([b"x", b"x", b"y"]))
            for _ in range(rng.randint(0, 8))
        ]
        expected = []
        for one in batch:
            key = (account, one.session_id, one.message_id)
            if key not in model:
                model[key] = one.body
                expected.append(ACCEPTED)
            else:
                expected.append(DUPLICATE if model[key] == one.body else CONFLICT)
        assert await append(open_log, account, *batch) == expected
    async with open_log() as log:
        claimed = await log.claim(1000)
    assert {(one.account_id, one.session_id, one.message_id): one.body for one in claimed} == model


async def test_a_unit_of_work_that_fails_appends_nothing(open_log: OpenLog, accounts: list[int]) -> None:
    with suppress(StopError):
        async with open_log() as log:
            assert await log.append(accounts[0], [entry(1)]) == [ACCEPTED]
            raise StopError
    assert await pending(open_log) == []
    assert await append(open_log, accounts[0], entry(1)) == [ACCEPTED]


async def test_what_is_claimed_is_pending_until_it_is_marked(open_log: OpenLog, accounts: list[int]) -> None:
    await append(open_log, accounts[0], *(entry(number) for number in (3, 1, 2)))
    await append(open_log, accounts[0], entry(9), entry(4))
    assert await pending(open_log) == [1, 2, 3, 4, 9]  # the older batch first
    assert await pending(open_log) == [1, 2, 3, 4, 9]  # a claim that fails gives back what it took
    async with open_log() as log:
        claimed = await log.claim(3)
        assert [message.message_id for message in claimed] == [1, 2, 3]
        await log.mark_fused([claimed[0].id])
        await log.quarantine({claimed[1].id: "cannot be read"})
    assert await pending(open_log) == [3, 4, 9]
    # What has been used or put aside is still known.
    assert await append(open_log, accounts[0], entry(1), entry(2, b"y")) == [DUPLICATE, CONFLICT]


async def test_two_workers_never_hold_the_same(open_log: OpenLog, accounts: list[int]) -> None:
    await append(open_log, accounts[0], *(entry(number) for number in range(1, 11)))
    async with open_log() as one, open_log() as other:
        first, second = await one.claim(6), await other.claim(6)
        assert [message.message_id for message in first] == [1, 2, 3, 4, 5, 6]
        assert [message.message_id for message in second] == [7, 8, 9, 10]


async def test_a_batch_leaves_half_of_a_backlog_to_another_worker(
    open_log: OpenLog, accounts: list[int], engine: AsyncEngine
) -> None:
    async def shares(*limits: int) -> list[int]:
        async with engine.connect() as connection:
            return [await worker_log.share(connection, limit) for limit in limits]

    await append(open_log, accounts[0], *(entry(number) for number in range(1, 31)))
    assert await shares(256, 20) == [32, 20]  # all of it
    await append(open_log, accounts[0], *(entry(number) for number in range(31, 202)))
    assert await shares(256, 64, 20) == [101, 64, 20]


async def test_the_oldest_comes_first_and_with_it_what_is_from_nearby(open_log: OpenLog, accounts: list[int]) -> None:
    regions = {1: 5, 2: 9, 3: 1, 4: 9, 5: 5, 6: 7, 7: 1}
    for number, region in regions.items():
        await append(open_log, accounts[0], LogEntry("s", number, b"x", region))
    async with open_log() as one, open_log() as other:
        assert [message.message_id for message in await one.claim(3)] == [1, 5, 6]
        assert [message.message_id for message in await other.claim(4)] == [2, 4, 3, 7]
    assert [message.message_id for message in await _claimed(open_log, 7)] == [1, 5, 6, 2, 4, 3, 7]


async def test_regions_where_others_are_at_work_are_left_to_them(
    open_log: OpenLog, accounts: list[int], engine: AsyncEngine
) -> None:
    """Their cells are taken: a batch that claims from there finds little that it can fuse."""
    for number, region in enumerate((5, 5, 9, 5, 7, 5), 1):
        await append(open_log, accounts[0], LogEntry("s", number, b"x", region))
    async with open_log() as one:
        assert [message.message_id for message in await one.claim(1)] == [1]
        assert [message.message_id for message in await _claimed(open_log, 6)] == [3, 5]
        async with engine.connect() as waited:  # for the oldest's cells
            again = await worker_log.claim(waited, 6, beside_others=True)
        assert [message.message_id for message in again] == [2, 5, 3]
        async with open_log() as other:
            assert [message.message_id for message in await other.claim(2)] == [3, 5]
            # nothing waits elsewhere
            assert [message.message_id for message in await _claimed(open_log, 6)] == [2, 4, 6]
    assert [message.message_id for message in await _claimed(open_log, 6)] == [1, 2, 4, 6, 5, 3]


async def test_claims_take_turns_and_wait_for_nobody(
    open_log: OpenLog, accounts: list[int], engine: AsyncEngine
) -> None:
    for number, region in enumerate((5, 9) * 4, 1):
        await append(open_log, accounts[0], LogEntry("s", number, b"x", region))
    async with open_log() as one, open_log() as other:
        claimed = await asyncio.gather(one.claim(4), other.claim(4))
        assert [{message.region for message in each} for each in claimed] in ([{5}, {9}], [{9}, {5}])
    async with engine.connect() as slow, turn(slow):  # somebody who never gives the turn back
        assert len(await _claimed(open_log, 8)) == 8


async def test_a_turn_that_fails_is_given_back(engine: AsyncEngine) -> None:
    with suppress(DBAPIError):
        async with engine.connect() as failing, turn(failing):
            await failing.execute(text("SELECT 1 / 0"))
    async with engine.connect() as next_one:
        assert (await next_one.execute(text("SELECT pg_try_advisory_xact_lock(4)"))).scalar_one()


async def test_what_is_fused_no_longer_says_where_it_was(
    open_log: OpenLog, accounts: list[int], engine: AsyncEngine
) -> None:
    await append(open_log, accounts[0], LogEntry("s", 1, b"x", 5), LogEntry("s", 2, b"x", 5))
    async with open_log() as log:
        await log.mark_fused([1])
    async with engine.connect() as connection:
        told = await connection.execute(text("SELECT state, region FROM messages ORDER BY id"))
        assert [tuple(row) for row in told] == [("fused", 0), ("pending", 5)]


async def test_nobody_waits_for_his_region_longer_than_a_few_batches(open_log: OpenLog, accounts: list[int]) -> None:
    """The oldest is followed by its own region; those of another one are not put off for what came long after them."""
    regions = [9, *(1 for _ in range(8)), *(9 for _ in range(20))]
    for number, region in enumerate(regions, 1):
        await append(open_log, accounts[0], LogEntry("s", number, b"x", region))
    assert [message.message_id for message in await _claimed(open_log, 3)] == [1, 10, 11]
    assert [message.message_id for message in await _claimed(open_log, 2)] == [1, 2]


async def _claimed(open_log: OpenLog, limit: int) -> list[ClaimedMessage]:
    async with open_log() as log:
        return await log.claim(limit)


async def test_batches_at_the_same_time_do_not_block_each_other_for_good(
    open_log: OpenLog, accounts: list[int]
) -> None:
    entries = [entry(number) for number in range(1, 101)]
    batches = [random.Random(seed).sample(entries, 60) for seed in range(6)]
    outcomes = await asyncio.gather(*(append(open_log, accounts[0], *batch) for batch in batches))
    taken = [outcome for batch in outcomes for outcome in batch]
    sent = {one.message_id for batch in batches for one in batch}
    assert taken.count(ACCEPTED) == len(sent)
    assert taken.count(CONFLICT) == 0
    assert await pending(open_log) != []
