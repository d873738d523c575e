"""What a vehicle may report at once, and what no camera can have seen."""

from __future__ import annotations

import asyncio
import contextlib
import gzip
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from datetime import timedelta
from typing import Any

import httpx
import pytest

from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import DetectionStatus, MeasuredPosition, ReportMessage
from slamcu_core.sensoris import join_batch, serialize_message
from slamcu_server.ingest import quota as quotas
from slamcu_server.ingest.body import read
from slamcu_server.ingest.plausibility import FINDS_AT_ONCE, FINDS_AT_ONE_PLACE, implausible
from slamcu_server.ingest.quota import Quota
from slamcu_server.problems import Problem
from slamcu_server.settings import Settings

pytestmark = pytest.mark.anyio

MakeReport = Callable[..., ReportMessage]


async def post(client: httpx.AsyncClient, headers: dict[str, str], *messages: ReportMessage) -> httpx.Response:
    content = join_batch([serialize_message(one) for one in messages])
    return await client.post(
        "/v1/data-messages", content=content, headers={**headers, "Content-Type": "application/x-protobuf"}
    )


def finds(message: ReportMessage, count: int, seconds: float, degrees: float) -> ReportMessage:
    """Replace the pass of a message by finds, each later and farther east than the one before."""
    (one,) = message.passes
    find = replace(one, status=DetectionStatus.NOT_EXPECTED_AND_DETECTED, reference=None)
    return replace(
        message,
        passes=tuple(
            replace(
                find,
                started_at=one.started_at + timedelta(seconds=number * seconds),
                ended_at=one.ended_at + timedelta(seconds=number * seconds),
                position=MeasuredPosition(2.1 + number * degrees, 48.9, (0.3, 0.0, 0.3)),
            )
            for number in range(count)
        ),
    )


async def test_what_no_camera_can_have_seen_is_refused_and_the_rest_is_kept(
    client: httpx.AsyncClient, vehicle: dict[str, str], town: MapIdentity, make_report: MakeReport
) -> None:
    answer = await post(
        client,
        vehicle,
        finds(make_report(1), FINDS_AT_ONCE + 1, 0.0, 0.001),
        finds(make_report(2), FINDS_AT_ONE_PLACE + 1, 10.0, 0.0),
        finds(make_report(3), FINDS_AT_ONCE, 0.0, 0.001),
        finds(make_report(4), 200, 10.0, 0.001),
        finds(make_report(5), FINDS_AT_ONE_PLACE, 10.0, 0.0),
    )
    assert answer.status_code == 202
    assert answer.json()["accepted"] == 3
    assert [(one["index"], one["reason"]) for one in answer.json()["rejected"]] == [
        (0, "too-many-finds"),
        (1, "too-many-finds"),
    ]


def test_who_begins_when_others_end_is_seen_together_with_them(make_report: MakeReport) -> None:
    """Half of the finds end at the instant at which the others begin."""

    def together(count: int) -> str | None:
        (one,) = make_report(1).passes
        before, after = (finds(make_report(1), count, 0.0, 0.001).passes for _ in range(2))
        length = one.ended_at - one.started_at
        after = tuple(replace(item, started_at=one.ended_at, ended_at=one.ended_at + length) for item in after)
        return implausible(replace(make_report(1), passes=before + after))

    assert together(FINDS_AT_ONCE // 2) is None
    assert together(FINDS_AT_ONCE // 2 + 1) == "66 finds in view at the same time, expected at most 64"


@pytest.fixture
def settings(database_url: str) -> Settings:
    return Settings(database_url=database_url, embedded_worker=False, passes_per_s=0.001, passes_burst=5)


async def test_who_reports_too_much_is_told_when_to_go_on_and_others_are_not(
    *,
    client: httpx.AsyncClient,
    vehicle: dict[str, str],
    town: MapIdentity,
    make_report: MakeReport,
    issue_key: Any,
    auth: Any,
) -> None:
    assert (await post(client, vehicle, *(make_report(number) for number in range(1, 3)))).status_code == 202
    # what is a duplicate costs too: reading it was work
    assert (await post(client, vehicle, make_report(1))).json()["duplicates"] == 1
    refused = await post(client, vehicle, make_report(3))
    assert refused.status_code == 429
    assert refused.json()["type"] == "urn:slamcu:problem:too-many-passes"
    assert 1000 <= int(refused.headers["retry-after"]) <= 2001
    other = auth(await issue_key("vehicle", "other"))
    assert (await post(client, other, make_report(1))).status_code == 202


async def test_batches_at_the_same_time_overdraw_no_more_than_one_does(
    client: httpx.AsyncClient, vehicle: dict[str, str], town: MapIdentity, make_report: MakeReport
) -> None:
    batches = [[make_report(100 * batch + number) for number in range(1, 31)] for batch in range(6)]
    answers = await asyncio.gather(*(post(client, vehicle, *batch) for batch in batches))
    assert sorted(answer.status_code for answer in answers) == [202, 429, 429, 429, 429, 429]
    assert (await post(client, vehicle, make_report(99))).status_code == 429


async def test_senders_so_slow_that_others_come_in_between_overdraw_no_more(
    client: httpx.AsyncClient, vehicle: dict[str, str], town: MapIdentity, make_report: MakeReport
) -> None:
    go_on, asked = asyncio.Event(), [asyncio.Event(), asyncio.Event()]

    async def slowly(number: int) -> AsyncIterator[bytes]:
        asked[number].set()
        await go_on.wait()
        yield join_batch([serialize_message(make_report(100 * number + one)) for one in range(1, 31)])

    headers = vehicle | {"Content-Type": "application/x-protobuf"}
    posts = [
        asyncio.create_task(client.post("/v1/data-messages", content=slowly(number), headers=headers))
        for number in (0, 1)
    ]
    await asyncio.gather(*(one.wait() for one in asked))  # both were let in while there was room
    go_on.set()
    assert sorted([answer.status_code for answer in await asyncio.gather(*posts)]) == [202, 429]


async def test_what_cannot_be_read_costs_what_it_could_have_held(
    client: httpx.AsyncClient, vehicle: dict[str, str], town: MapIdentity, make_report: MakeReport
) -> None:
    headers = vehicle | {"Content-Type": "application/x-protobuf"}
    assert (await client.post("/v1/data-messages", content=b"\xff" * 200, headers=headers)).status_code == 400
    assert (await post(client, vehicle, make_report(1))).status_code == 429


async def test_a_gzip_stream_of_ever_so_many_members_is_refused_at_once(
    client: httpx.AsyncClient, vehicle: dict[str, str], town: MapIdentity, make_report: MakeReport
) -> None:
    headers = vehicle | {"Content-Type": "application/x-protobuf", "Content-Encoding": "gzip"}
    content = gzip.compress(b"") * 65
    answer = await client.post("/v1/data-messages", content=content, headers=headers)
    assert (answer.status_code, answer.json()["type"]) == (400, "urn:slamcu:problem:bad-encoding")
    # one member a message is what a sender may make
    members = b"".join(gzip.compress(join_batch([serialize_message(make_report(one))])) for one in (1, 2))
    assert (await client.post("/v1/data-messages", content=members, headers=headers)).json()["accepted"] == 2


@pytest.mark.parametrize("gzipped", [False, True])
async def test_a_body_of_the_limit_is_read_and_a_byte_more_is_not(gzipped: bool) -> None:
    async def chunks(length: int) -> AsyncIterator[bytes]:
        content = gzip.compress(bytes(length)) if gzipped else bytes(length)
        yield content[:7]
        yield content[7:]

    assert await read(chunks(200_000), gzip=gzipped, limit=200_000) == bytes(200_000)
    with pytest.raises(Problem) as refused:
        await read(chunks(200_001), gzip=gzipped, limit=200_000)
    assert (refused.value.status_code, refused.value.code) == (413, "body-too-large")


async def test_others_have_their_turn_while_a_body_is_inflated() -> None:
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    async def chunks() -> AsyncIterator[bytes]:
        yield gzip.compress(bytes(4 * 2**20))

    counting = asyncio.create_task(count())
    assert len(await read(chunks(), gzip=True, limit=8 * 2**20)) == 4 * 2**20
    counting.cancel()
    assert turns > 50


def test_a_bucket_fills_steadily_and_holds_no_more_than_a_burst() -> None:
    now = 0.0
    quota = Quota(2.0, 10.0, lambda: now)
    quota.charge(1, 30)
    assert quota.wait_s(1) == pytest.approx(10.5)
    assert quota.wait_s(2) == 0.0
    now = 10.6
    assert quota.wait_s(1) == 0.0
    now = 1e6
    quota.charge(1, 9)
    assert quota.wait_s(1) == 0.0
    quota.charge(1, 2)
    assert quota.wait_s(1) > 0.0
    assert Quota(0.0, 1.0).wait_s(1) == 0.0


def test_a_batch_that_fails_gives_back_what_was_kept_for_it() -> None:
    quota = Quota(2.0, 10.0, lambda: 0.0)
    with contextlib.suppress(ValueError), quota.holding(1, 50):
        assert quota.wait_s(1) > 0.0, "what is being read may be more than the bucket has"
        assert quota.wait_s(2) == 0.0
        raise ValueError("the body cannot be read")
    assert quota.wait_s(1) == 0.0


def test_the_account_that_has_been_silent_longest_is_forgotten_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quotas, "_ACCOUNTS", 2)
    quota = Quota(2.0, 10.0, lambda: 0.0)
    for account in (1, 2, 1, 3):
        quota.charge(account, 10)
    assert [quota.wait_s(account) > 0.0 for account in (1, 2, 3)] == [True, False, True]
