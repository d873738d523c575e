"""What is sent is logged once, the good of a batch is kept, and the bad is named."""

from __future__ import annotations

import asyncio
import gzip
import json
from collections.abc import Awaitable, Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.formats import write_hd_map
from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import MapReference, ReportMessage
from slamcu_core.sensoris import decode_message, encode_batch, join_batch, serialize_message, to_json
from slamcu_server.accounts.schemas import IssuedKey
from slamcu_server.aggregation.condensed import condense
from slamcu_server.ingest.schemas import EXAMPLE_BATCH
from slamcu_server.maps.importer import import_map

pytestmark = [pytest.mark.anyio, pytest.mark.usefixtures("town")]

MakeReport = Callable[..., ReportMessage]
IssueKey = Callable[..., Awaitable[IssuedKey]]
Auth = Callable[[IssuedKey], dict[str, str]]
PROTOBUF = {"Content-Type": "application/x-protobuf"}


class Sender:
    """A vehicle that sends batches."""

    def __init__(self, client: httpx.AsyncClient, headers: dict[str, str]) -> None:
        self._client, self._headers = client, headers

    async def send(self, body: bytes, **headers: str) -> httpx.Response:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        return await self._client.post("/v1/data-messages", content=body, headers=self._headers | PROTOBUF | named)

    async def send_reports(self, *reports: ReportMessage) -> httpx.Response:
        return await self.send(encode_batch(reports))


@pytest.fixture
def sender(client: httpx.AsyncClient, vehicle: dict[str, str]) -> Sender:
    return Sender(client, vehicle)


async def logged(engine: AsyncEngine) -> list[tuple[int, str, int, bytes]]:
    async with engine.connect() as connection:
        rows = await connection.execute(
            text("SELECT account_id, session_id, message_id, body FROM messages ORDER BY id")
        )
        return [(row.account_id, row.session_id, row.message_id, bytes(row.body)) for row in rows]


async def test_a_batch_is_logged_as_it_was_sent(sender: Sender, engine: AsyncEngine, make_report: MakeReport) -> None:
    reports = [make_report(number) for number in (3, 1, 2)]
    answer = await sender.send_reports(*reports)
    assert answer.status_code == 202
    assert answer.json() == {"accepted": 3, "duplicates": 0, "rejected": []}
    stored = await logged(engine)
    assert {(session, number): body for _, session, number, body in stored} == {
        ("drive", report.message_id): serialize_message(report) for report in reports
    }
    async with engine.connect() as connection:
        rows = await connection.execute(text("SELECT message_id, condensed FROM messages"))
        assert {number: bytes(form) for number, form in rows} == {
            report.message_id: condense(decode_message(serialize_message(report))) for report in reports
        }


async def test_the_same_again_is_a_duplicate(sender: Sender, engine: AsyncEngine, make_report: MakeReport) -> None:
    await sender.send_reports(make_report(1), make_report(2))
    answer = await sender.send_reports(make_report(2), make_report(3), make_report(3))
    assert answer.status_code == 202
    assert answer.json() == {"accepted": 1, "duplicates": 2, "rejected": []}
    assert [number for _, _, number, _ in await logged(engine)] == [1, 2, 3]


async def test_the_same_ids_with_other_bytes_are_refused_by_name(
    sender: Sender, engine: AsyncEngine, make_report: MakeReport
) -> None:
    await sender.send_reports(make_report(1))
    other = [replace(make_report(number), fleet_id="other") for number in (1, 2)]
    answer = await sender.send_reports(make_report(2), *other)
    assert answer.status_code == 202
    body = answer.json()
    assert (body["accepted"], body["duplicates"]) == (1, 0)
    assert [(one["index"], one["message_id"], one["reason"]) for one in body["rejected"]] == [
        (1, 1, "conflicting-bytes"),
        (2, 2, "conflicting-bytes"),  # within the batch the first counts
    ]
    assert all(one["session_id"] == "drive" for one in body["rejected"])
    bodies = [body for *_, body in await logged(engine)]
    assert bodies == [serialize_message(make_report(1)), serialize_message(make_report(2))]


async def test_ids_are_an_account_s_own(
    client: httpx.AsyncClient, engine: AsyncEngine, make_report: MakeReport, issue_key: IssueKey, auth: Auth
) -> None:
    # The second one labels itself as the first does, and still is itself.
    for label, fleet in (("one", "a"), ("two", "b")):
        sender = Sender(client, auth(await issue_key("vehicle", label)))
        answer = await sender.send_reports(replace(make_report(1), fleet_id=fleet, vehicle_id="me"))
        assert answer.json()["accepted"] == 1
    assert len({account for account, *_ in await logged(engine)}) == 2


async def test_the_good_of_a_batch_is_kept_and_the_bad_is_named(
    sender: Sender, engine: AsyncEngine, make_report: MakeReport
) -> None:
    def sent(report: ReportMessage) -> bytes:
        return serialize_message(report)

    about = make_report(9).passes[0]
    batch = [
        sent(make_report(1)),
        b"\xff\xff\xff",
        sent(replace(make_report(2), map_identity=MapIdentity("toyland", "1"))),
        sent(replace(make_report(3), map_identity=MapIdentity("town", "99"))),
        sent(replace(make_report(4), passes=(replace(about, reference=MapReference(1, 4711)),))),
        sent(replace(make_report(5), passes=(replace(about, reference=MapReference(-1, 4711)),))),
        sent(make_report(6)).replace(b"drive", b""),
        sent(make_report(7)),
    ]
    answer = await sender.send(join_batch(batch))
    assert answer.status_code == 202, answer.text
    body = answer.json()
    assert body["accepted"] == 2
    rejected = {one["index"]: one for one in body["rejected"]}
    assert {index: one["reason"] for index, one in rejected.items()} == {
        1: "not-protobuf",
        2: "unknown-map",
        3: "unknown-map-version",
        4: "unknown-feature",
        5: "unknown-feature",
        6: rejected[6]["reason"],
    }
    assert "toyland" in rejected[2]["detail"]
    assert "watch feature 4711" in rejected[5]["detail"]
    assert [number for _, _, number, _ in await logged(engine)] == [1, 7]


async def test_where_nothing_is_taken_the_answer_is_422(sender: Sender, make_report: MakeReport) -> None:
    lost = replace(make_report(1), map_identity=MapIdentity("toyland", "1"))
    answer = await sender.send_reports(lost)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["type"] == "urn:slamcu:problem:nothing-accepted"
    assert answer.json()["rejected"][0]["reason"] == "unknown-map"
    # A duplicate beside it is something that was taken, earlier.
    await sender.send_reports(make_report(2))
    assert (await sender.send_reports(lost, make_report(2))).status_code == 202


async def test_an_empty_batch_is_taken(sender: Sender) -> None:
    answer = await sender.send(b"")
    assert (answer.status_code, answer.json()) == (202, {"accepted": 0, "duplicates": 0, "rejected": []})


async def test_a_clock_that_is_ahead_is_refused(sender: Sender, make_report: MakeReport) -> None:
    later = datetime.now(UTC) + timedelta(days=2)
    one = replace(make_report(1).passes[0], started_at=later, ended_at=later + timedelta(seconds=1))
    answer = await sender.send_reports(replace(make_report(1), passes=(one,)))
    assert answer.status_code == 422
    assert answer.json()["rejected"][0]["reason"] == "bad-time"


async def test_json_and_gzip(sender: Sender, engine: AsyncEngine, make_report: MakeReport) -> None:
    as_json = to_json(encode_batch([make_report(1)])).encode()
    answer = await sender.send(as_json, Content_Type="application/json; charset=utf-8")
    assert (answer.status_code, answer.json()["accepted"]) == (202, 1)
    answer = await sender.send(gzip.compress(as_json), Content_Type="application/json", Content_Encoding="gzip")
    assert (answer.status_code, answer.json()["duplicates"]) == (202, 1)
    half = encode_batch([make_report(2)])
    members = gzip.compress(half[:50]) + gzip.compress(half[50:])  # gzip files may be put one behind the other
    answer = await sender.send(members, Content_Encoding="gzip")
    assert (answer.status_code, answer.json()["accepted"]) == (202, 1)
    # Protobuf and its JSON mapping are the same message.
    assert (await sender.send_reports(make_report(1))).json()["duplicates"] == 1
    assert len(await logged(engine)) == 2


async def test_the_example_of_the_documentation_works(
    app: FastAPI, sender: Sender, engine: AsyncEngine, tmp_path: Path
) -> None:
    path = tmp_path / "demo.geojson"
    path.write_text("".join(write_hd_map(MapIdentity("demo", "2026.05.1"), [])))
    async with engine.begin() as connection:
        await import_map(connection, path)
    schema = app.openapi()
    content = schema["paths"]["/v1/data-messages"]["post"]["requestBody"]["content"]
    assert content["application/json"]["example"] == EXAMPLE_BATCH
    answer = await sender.send(json.dumps(EXAMPLE_BATCH).encode(), Content_Type="application/json")
    assert (answer.status_code, answer.json()["accepted"]) == (202, 1), answer.text


async def test_two_at_once_log_it_once(sender: Sender, engine: AsyncEngine, make_report: MakeReport) -> None:
    reports = [make_report(number) for number in range(1, 41)]
    answers = await asyncio.gather(
        sender.send_reports(*reports), sender.send_reports(*reversed(reports)), sender.send_reports(*reports[20:])
    )
    assert all(answer.status_code == 202 for answer in answers)
    assert sum(answer.json()["accepted"] for answer in answers) == 40
    assert sum(answer.json()["duplicates"] for answer in answers) == 60
    assert len(await logged(engine)) == 40


async def test_the_worker_is_called(
    sender: Sender, engine: AsyncEngine, database_url: str, make_report: MakeReport
) -> None:
    import asyncpg

    called = asyncio.Event()
    listener = await asyncpg.connect(database_url.replace("+asyncpg", ""))
    await listener.add_listener("slamcu_messages", lambda *_: called.set())
    await sender.send_reports(make_report(1))
    await asyncio.wait_for(called.wait(), 10)
    called.clear()
    await sender.send_reports(make_report(1))  # nothing new: nobody is called
    await listener.execute("SELECT 1")
    assert not called.is_set()
    await listener.close()


async def test_it_is_counted(client: httpx.AsyncClient, sender: Sender, make_report: MakeReport) -> None:
    await sender.send_reports(make_report(1), make_report(2))
    await sender.send_reports(make_report(2), replace(make_report(3), map_identity=MapIdentity("toyland", "1")))
    metrics = (await client.get("/metrics")).text
    for line in (
        'slamcu_ingest_messages_total{outcome="accepted"} 2.0',
        'slamcu_ingest_messages_total{outcome="duplicate"} 1.0',
        'slamcu_ingest_messages_total{outcome="rejected"} 1.0',
        'slamcu_ingest_rejections_total{reason="unknown-map"} 1.0',
        "slamcu_aggregation_pending_messages 2.0",
        'slamcu_http_requests_total{method="POST",route="/v1/data-messages",status="202"} 2.0',
    ):
        assert line in metrics, line


@pytest.mark.parametrize("role", ["provider", None])
async def test_only_vehicles_report(
    client: httpx.AsyncClient, engine: AsyncEngine, make_report: MakeReport, provider: dict[str, str], role: str | None
) -> None:
    answer = await client.post(
        "/v1/data-messages", content=encode_batch([make_report(1)]), headers=PROTOBUF | (provider if role else {})
    )
    assert answer.status_code == (403 if role else 401)
    assert await logged(engine) == []


BOMB = gzip.compress(b"\0" * 200_000_000)
BAD_BODIES: dict[str, tuple[bytes, dict[str, str], int]] = {
    "text": (b"hello, this is no protobuf", {}, 400),
    "ten million bytes": (b"\x00" * 10_000_000, {}, 413),
    "a zip bomb": (BOMB, {"Content_Encoding": "gzip"}, 413),
    "a zip bomb in JSON": (BOMB, {"Content_Encoding": "gzip", "Content_Type": "application/json"}, 413),
    "no gzip": (b"\x0a\x00", {"Content_Encoding": "gzip"}, 400),
    "nothing as gzip": (b"", {"Content_Encoding": "gzip"}, 400),
    "half a gzip": (gzip.compress(b"\x0a\x00" * 99)[:-9], {"Content_Encoding": "gzip"}, 400),
    "another encoding": (b"\x0a\x00", {"Content_Encoding": "br"}, 415),
    "another type": (b"<xml/>", {"Content_Type": "application/xml"}, 415),
    "no type": (b"\x0a\x00", {"Content_Type": ""}, 415),
    "too many messages": (join_batch([b""] * 1001), {}, 413),
    "no JSON": (b"{", {"Content_Type": "application/json"}, 400),
    "JSON of another kind": (b"[1, 2]", {"Content_Type": "application/json"}, 400),
    "deep JSON": (b"[" * 100_000, {"Content_Type": "application/json"}, 400),
    "broken UTF-8": (b'{"dataMessage": "\xff\xfe"}', {"Content_Type": "application/json"}, 400),
}


@pytest.mark.parametrize("name", BAD_BODIES)
async def test_a_bad_body_is_the_client_s_mistake(sender: Sender, engine: AsyncEngine, name: str) -> None:
    body, headers, status = BAD_BODIES[name]
    answer = await sender.send(body, **headers)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["status"] == status
    assert problem["type"].startswith("urn:slamcu:problem:")
    assert problem["detail"]
    assert await logged(engine) == []


async def test_a_bomb_is_not_unpacked(sender: Sender) -> None:
    import tracemalloc

    tracemalloc.start()
    try:
        await sender.send(BOMB, Content_Encoding="gzip")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 40_000_000  # of 200 MB


HOSTILE_JSON: dict[str, Any] = {
    "a nul in an id": {"envelope": {"ids": {"sessionId": "a\0b", "messageId": "1"}}},
    "a lone surrogate": {"envelope": {"ids": {"sessionId": "\ud800", "messageId": "1"}}},
    "an id beyond 64 bits": {"envelope": {"ids": {"sessionId": "a", "messageId": str(2**64)}}},
    "a negative id": {"envelope": {"ids": {"sessionId": "a", "messageId": "-1"}}},
    "a very long id": {"envelope": {"ids": {"sessionId": "a" * 100_000, "messageId": "1"}}},
    "no ids": {"envelope": {}},
    "a list": [],
    "a number": 7,
    "null": None,
    "a wrong type": {"envelope": {"ids": {"sessionId": {"x": 1}, "messageId": []}}},
    "an unknown map": {"envelope": {"ids": {"sessionId": "a", "messageId": "1"}}},
}


@pytest.mark.parametrize("name", HOSTILE_JSON)
async def test_hostile_messages_are_refused_with_a_reason(sender: Sender, engine: AsyncEngine, name: str) -> None:
    body = json.dumps({"dataMessage": [HOSTILE_JSON[name]]}).encode()
    answer = await sender.send(body, Content_Type="application/json")
    assert answer.status_code == 422, answer.text
    (rejected,) = answer.json()["rejected"]
    assert rejected["index"] == 0
    assert rejected["reason"]
    assert len(rejected["detail"]) < 1000
    assert await logged(engine) == []
