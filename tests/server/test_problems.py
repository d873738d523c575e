"""Every error is a problem document, nothing a client sends is a 500, and nothing inside shows."""

from __future__ import annotations

import asyncio
import itertools
import logging
import re
from typing import Any
from urllib.parse import quote

import asyncpg
import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy import text
from sqlalchemy.exc import DBAPIError
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_server.app import create_app
from slamcu_server.database import transactions
from slamcu_server.database.engine import create_engine
from slamcu_server.settings import Settings

pytestmark = pytest.mark.anyio

OPEN = {"/livez", "/readyz", "/metrics"}


def problem_of(answer: httpx.Response) -> dict[str, Any]:
    assert answer.headers["content-type"] == "application/problem+json"
    problem: dict[str, Any] = answer.json()
    assert problem["status"] == answer.status_code
    assert re.fullmatch("urn:slamcu:problem:[a-z]+(-[a-z]+)*", problem["type"])
    assert problem["title"]
    return problem


async def test_an_unknown_route_is_404_and_a_wrong_method_405(client: httpx.AsyncClient) -> None:
    for path in ("/nowhere", "/v1", "/v1/", "/v1/maps/", "//", "/%00", "/v1/data-messages/"):
        answer = await client.get(path)
        assert (answer.status_code, problem_of(answer)["type"]) == (404, "urn:slamcu:problem:not-found"), path
        assert "/v1/" in problem_of(answer)["detail"]
    answer = await client.delete("/v1/maps")
    assert answer.status_code == 405
    assert "GET" in answer.headers["allow"]
    assert problem_of(answer)["type"] == "urn:slamcu:problem:method-not-allowed"


async def test_an_unexpected_error_shows_nothing_and_is_logged(
    app: FastAPI, client: httpx.AsyncClient, caplog: pytest.LogCaptureFixture
) -> None:
    @app.get("/broken")
    async def broken() -> None:
        raise RuntimeError("the secret of the kitchen")

    answer = await client.get("/broken")
    assert answer.status_code == 500
    assert problem_of(answer)["detail"] == "an unexpected error; it has been logged"
    assert "kitchen" not in answer.text
    assert any(record.exc_info and "kitchen" in str(record.exc_info[1]) for record in caplog.records)
    assert 'route="/broken",status="500"' in (await client.get("/metrics")).text


@pytest.mark.parametrize(
    ("body", "wrong"),
    [
        (b'{"decision": "\xc3"}', "cannot be read; expected JSON in UTF-8"),
        (b"[" * 100_000, "cannot be read; expected JSON in UTF-8"),
        (b'{"decision": accept}', "expected JSON: Expecting value at character 13"),
    ],
    ids=["latin", "deep", "bare"],
)
async def test_a_body_that_is_no_json_is_an_invalid_request(
    client: httpx.AsyncClient, admin: dict[str, str], body: bytes, wrong: str
) -> None:
    headers = admin | {"Content-Type": "application/json", "If-Match": '"1-1"'}
    for path in ("/v1/changes/1/review", "/v1/evidence/retract"):
        answer = await client.post(path, content=body, headers=headers)
        assert answer.status_code == 422
        assert problem_of(answer)["errors"] == [{"field": "body", "detail": wrong}]


async def test_a_number_is_no_time(client: httpx.AsyncClient, admin: dict[str, str]) -> None:
    """1777622400 may be of seconds or of milliseconds; whoever guesses is wrong by fifty thousand years."""
    for path in (
        "/v1/features?map=town&not_looked_since=1777622400",
        "/v1/coverage?map=town&bbox=2,48,3,49&since=-0.5",
        "/v1/changes/1?as_of=1777622400000",
    ):
        problem = problem_of(await client.get(path, headers=admin))
        assert (problem["status"], problem["type"]) == (422, "urn:slamcu:problem:invalid-request"), path
        assert "expected a date and time with its zone, such as 2026-05-01T08:00:00Z" in problem["detail"]
    asked = {"fleet_id": "north", "event_from": 1777622400, "reason": "a test"}
    problem = problem_of(await client.post("/v1/evidence/retract", json=asked, headers=admin))
    assert problem["errors"][0]["field"] == "body.event_from"


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (asyncpg.DeadlockDetectedError("deadlock"), 503),
        (asyncpg.AdminShutdownError("terminating connection"), 503),
        (asyncpg.UndefinedTableError("no such table"), 500),
        (DBAPIError("SELECT 1", None, RuntimeError("gone"), connection_invalidated=True), 503),
        (DBAPIError("SELECT 1", None, RuntimeError("else"), connection_invalidated=False), 500),
        (ConnectionRefusedError(111, "Connection refused"), 503),
        (FileNotFoundError(2, "No such file", "policy.json"), 500),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else str(value),
)
async def test_only_what_a_repeat_may_cure_is_asked_to_be_repeated(
    app: FastAPI, client: httpx.AsyncClient, error: Exception, status: int
) -> None:
    @app.get("/broken")
    async def broken() -> None:
        raise error

    answer = await client.get("/broken")
    assert answer.status_code == status
    assert answer.headers.get("retry-after") == ("1" if status == 503 else None)


async def test_a_failed_request_leaves_nothing_behind(
    app: FastAPI, client: httpx.AsyncClient, engine: AsyncEngine
) -> None:
    from slamcu_server.database.transactions import WriteTransaction
    from slamcu_server.problems import Problem

    # The application's annotations are read in the module's namespace, which does not have this one.
    async def half(connection: Any) -> None:
        await connection.execute(text("INSERT INTO accounts (role, label) VALUES ('vehicle', 'half')"))
        raise Problem(409, "half-way", "stopped half-way")

    half.__annotations__ = {"connection": WriteTransaction, "return": None}
    app.post("/half")(half)
    assert (await client.post("/half")).status_code == 409
    async with engine.connect() as connection:
        assert (await connection.execute(text("SELECT count(*) FROM accounts WHERE label = 'half'"))).scalar_one() == 0


async def test_without_its_database_it_says_so_and_asks_to_come_again(
    settings: Settings, vehicle: dict[str, str]
) -> None:
    for url in ("postgresql+asyncpg://slamcu@/x?host=/nonexistent", "postgresql+asyncpg://slamcu@127.0.0.1:1/x"):
        engine = create_engine(url)
        app = create_app(settings, engine=engine)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://slamcu.test") as client,
        ):
            for path in ("/v1/maps", "/readyz", "/metrics"):
                answer = await client.get(path, headers=vehicle)
                assert answer.status_code == 503, path
                assert answer.headers["retry-after"] == "1"
                assert "nonexistent" not in problem_of(answer)["detail"]
            assert (await client.get("/livez")).status_code == 200
        await engine.dispose()


async def test_a_read_that_takes_too_long_is_given_up(
    app: FastAPI, client: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def slow(connection: Any) -> None:
        await connection.execute(text("SELECT pg_sleep(20)"))

    monkeypatch.setattr(transactions, "_STATEMENT_TIMEOUT", text("SET LOCAL statement_timeout = '100ms'"))
    slow.__annotations__ = {"connection": transactions.ReadTransaction, "return": None}
    app.get("/slow")(slow)
    answer = await client.get("/slow")
    assert answer.status_code == 503
    assert answer.headers["retry-after"] == "1"
    assert problem_of(answer)["type"] == "urn:slamcu:problem:database-unavailable"


async def test_a_declared_length_is_refused_before_it_is_sent(
    client: httpx.AsyncClient, vehicle: dict[str, str], settings: Settings
) -> None:
    read = False

    async def body() -> Any:
        nonlocal read
        read = True  # an error here would be the application's, which the client does not see
        yield b"\0" * (settings.max_body_bytes + 1)

    headers = vehicle | {
        "Content-Type": "application/x-protobuf",
        "Content-Length": str(settings.max_body_bytes + 1),
    }
    answer = await client.post("/v1/data-messages", content=body(), headers=headers)
    assert answer.status_code == 413
    problem_of(answer)
    assert not read


@pytest.mark.parametrize("declared", [True, False])
@pytest.mark.parametrize(("more", "code"), [(0, "not-protobuf"), (1, "body-too-large")])
async def test_a_body_of_the_greatest_length_is_read_and_a_longer_one_is_not(
    *, client: httpx.AsyncClient, vehicle: dict[str, str], settings: Settings, declared: bool, more: int, code: str
) -> None:
    body = b"\xff" * (settings.max_body_bytes + more)

    async def pieces() -> Any:
        for begin in range(0, len(body), 2**16):
            yield body[begin : begin + 2**16]

    headers = vehicle | {"Content-Type": "application/x-protobuf"}
    answer = await client.post("/v1/data-messages", content=body if declared else pieces(), headers=headers)
    assert problem_of(answer)["type"] == f"urn:slamcu:problem:{code}"


async def test_headers_keep_browsers_and_caches_at_bay(client: httpx.AsyncClient, vehicle: dict[str, str]) -> None:
    for path in ("/livez", "/v1/maps", "/nowhere"):
        headers = (await client.get(path, headers=vehicle)).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-store"
        assert "server" not in headers


async def test_the_access_log_names_keys_and_no_secrets(
    client: httpx.AsyncClient, vehicle: dict[str, str], caplog: pytest.LogCaptureFixture
) -> None:
    key_id, secret = vehicle["Authorization"].split("_", 2)[1:]
    with caplog.at_level(logging.DEBUG):
        await client.get("/v1/maps/town-hall/features?bbox=1,2,3,4", headers=vehicle)
    (line,) = [record.getMessage() for record in caplog.records if record.name == "slamcu_server.access"]
    assert line.startswith("GET /v1/maps/{source}/features 404 ")
    assert key_id in line
    assert secret not in caplog.text


def operations(schema: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    return [(path, method, operation) for path, item in schema["paths"].items() for method, operation in item.items()]


async def test_the_documentation_is_complete(app: FastAPI, client: httpx.AsyncClient) -> None:
    schema = (await client.get("/openapi.json")).json()
    assert schema["components"]["securitySchemes"]["key"]["scheme"] == "bearer"
    assert "ProblemDocument" in schema["components"]["schemas"]
    assert "HTTPValidationError" not in schema["components"]["schemas"]
    for path, method, operation in operations(schema):
        where = f"{method} {path}"
        assert operation["description"], where
        assert ("security" in operation) == (path not in OPEN), where
        for status, answer in operation["responses"].items():
            if int(status) >= 400:
                assert list(answer["content"]) == ["application/problem+json"], f"{where} {status}"


@pytest.mark.parametrize(("path", "least"), [("/docs", 3), ("/redoc", 2)])
async def test_the_page_of_the_documentation_loads_nothing_from_elsewhere(
    client: httpx.AsyncClient, path: str, least: int
) -> None:
    page = await client.get(path)
    loaded = re.findall(r"""(?:src|href)=["']([^"']+)["']""", page.text)
    assert page.status_code == 200
    assert len(loaded) >= least
    assert all(address.startswith("/docs/static/") for address in loaded)  # which the proxy lets in
    for address in loaded:
        assert (await client.get(address)).status_code == 200, address
    missing = await client.get(loaded[0] + ".map")
    assert (missing.status_code, missing.headers["content-type"]) == (404, "application/problem+json")


NASTY = (
    "", "0", "-1", "1", "9" * 18, "9" * 30, "1.5", "nan", "inf", "1e400", "true", "null", "\0", "a\0b", "\n", "💥",
    "'; DROP TABLE maps; --", "%", "../..", "1,2,3,4", "0,0,0,0", "-180,-90,180,90", "a" * 5000, "2026-05-01T08:00:00Z",
    "9999-12-31T23:59:59Z", "0000-00-00", "[]", "{}", "confirmed", "deleted", "watch-1",
)  # fmt: skip


@pytest.mark.usefixtures("town")
async def test_no_query_is_an_unexpected_error(app: FastAPI, client: httpx.AsyncClient, admin: dict[str, str]) -> None:
    for path, method, operation in operations(app.openapi()):
        if method != "get":
            continue
        parameters = operation.get("parameters", [])
        in_path = [one["name"] for one in parameters if one["in"] == "path"]
        in_query = [one["name"] for one in parameters if one["in"] == "query"]
        urls = [path.format(**dict.fromkeys(in_path, quote(nasty, safe=""))) for nasty in NASTY if nasty and in_path]
        plain = path.format(**dict.fromkeys(in_path, "1")).replace("/maps/1/", "/maps/town/")
        urls += [
            f"{plain}?{name}={quote(nasty.encode(), safe='')}" for name, nasty in itertools.product(in_query, NASTY)
        ]
        answers = await asyncio.gather(*(client.get(url, headers=admin) for url in urls))
        for url, answer in zip(urls, answers, strict=True):
            assert answer.status_code in {200, 304, 400, 404, 422}, (url[:200], answer.text)
            if answer.status_code >= 400:
                problem_of(answer)


@pytest.mark.usefixtures("town")
@pytest.mark.parametrize(
    "body",
    [b"", b"{", b"[]", b"null", b'"x"', b"\xff\xfe", b'{"decision": "\\ud800"}', b'{"decision": 1e999}', b"[" * 9999],
)
async def test_no_body_is_an_unexpected_error(
    app: FastAPI, client: httpx.AsyncClient, admin: dict[str, str], body: bytes
) -> None:
    for path, method, operation in operations(app.openapi()):
        if method == "get":
            continue
        in_path = [one["name"] for one in operation.get("parameters", []) if one["in"] == "path"]
        url = path.format(**dict.fromkeys(in_path, "1"))
        for extra in ({}, {"Content-Type": "application/json"}, {"Content-Type": "text/plain", "If-Match": "nonsense"}):
            answer = await client.request(method, url, content=body, headers=admin | extra)
            assert answer.status_code < 500, (url, answer.text)
            if answer.status_code >= 400:
                problem_of(answer)
