"""Keys: who may do what, rotated and revoked, and never to be read back."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from datetime import datetime, timedelta

import httpx
import pytest
from fastapi import APIRouter, FastAPI
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_server.accounts import repository, service
from slamcu_server.accounts.authentication import Admin, MapReader, Provider, Reporter
from slamcu_server.accounts.schemas import IssuedKey, StoredKey

pytestmark = pytest.mark.anyio

IssueKey = Callable[..., Awaitable[IssuedKey]]
Auth = Callable[[IssuedKey], dict[str, str]]


@pytest.fixture(autouse=True)
def doors(app: FastAPI) -> None:
    """One door for each kind of admission."""
    router = APIRouter(prefix="/doors")

    @router.get("/report")
    async def report(principal: Reporter) -> int:
        return principal.account_id

    @router.get("/maps")
    async def maps(principal: MapReader) -> int:
        return principal.account_id

    @router.get("/provide")
    async def provide(principal: Provider) -> int:
        return principal.account_id

    @router.get("/admin")
    async def admin(principal: Admin) -> int:
        return principal.account_id

    app.include_router(router)


@pytest.mark.parametrize(
    ("role", "open_doors"),
    [
        ("vehicle", {"report", "maps"}),
        ("provider", {"maps", "provide"}),
        ("admin", {"report", "maps", "provide", "admin"}),
    ],
)
async def test_a_role_opens_its_doors_only(
    client: httpx.AsyncClient, issue_key: IssueKey, auth: Auth, role: str, open_doors: set[str]
) -> None:
    headers = auth(await issue_key(role))
    for door in ("report", "maps", "provide", "admin"):
        answer = await client.get(f"/doors/{door}", headers=headers)
        assert answer.status_code == (200 if door in open_doors else 403), door
        if answer.status_code == 403:
            assert answer.headers["content-type"] == "application/problem+json"
            assert answer.json()["type"] == "urn:slamcu:problem:role-insufficient"
            assert role in answer.json()["detail"]
            assert 'error="insufficient_scope"' in answer.headers["www-authenticate"]


@pytest.mark.parametrize(
    "header",
    [
        None,
        "Bearer",
        "Bearer ",
        "Basic dXNlcjpwYXNz",
        "Bearer slamcu_0123456789abcdef_" + "A" * 43,
        "Bearer nonsense",
        "Bearer slamcu_%00_x",
        "Bearer " + "x" * 10_000,
    ],
)
async def test_no_key_or_a_wrong_one_is_401(client: httpx.AsyncClient, header: str | None) -> None:
    answer = await client.get("/doors/maps", headers={"Authorization": header} if header is not None else {})
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"].startswith("Bearer")
    assert answer.json()["status"] == 401


async def test_the_right_id_with_another_secret_is_401(
    client: httpx.AsyncClient, issue_key: IssueKey, auth: Auth
) -> None:
    one, other = await issue_key("vehicle"), await issue_key("vehicle")
    forged = one.key[: len("slamcu_") + 17] + other.key[len("slamcu_") + 17 :]
    assert (await client.get("/doors/maps", headers=auth(one))).status_code == 200
    assert (await client.get("/doors/maps", headers={"Authorization": f"Bearer {forged}"})).status_code == 401


async def test_the_secret_is_nowhere_in_the_database(engine: AsyncEngine, issue_key: IssueKey) -> None:
    issued = await issue_key("vehicle", "van")
    secret = issued.key.split("_", 2)[2]
    async with engine.connect() as connection:
        stored = (await connection.execute(text("SELECT to_jsonb(api_keys)::text FROM api_keys"))).scalars().all()
    assert len(stored) == 1
    assert secret not in stored[0]
    assert issued.key_id in stored[0]


async def test_an_account_outlives_its_keys(
    client: httpx.AsyncClient, engine: AsyncEngine, issue_key: IssueKey, auth: Auth
) -> None:
    first = await issue_key("vehicle", "van")
    account = (await client.get("/doors/report", headers=auth(first))).json()
    async with engine.begin() as connection:
        second = await service.rotate_key(connection, first.key_id, timedelta(hours=1))
    async with engine.begin() as connection:
        third = await service.add_key(connection, "van")
    for key in (first, second, third):  # the old one has an hour left
        assert (await client.get("/doors/report", headers=auth(key))).json() == account


async def test_a_rotated_key_ends_when_its_grace_does(
    client: httpx.AsyncClient, engine: AsyncEngine, issue_key: IssueKey, auth: Auth
) -> None:
    first = await issue_key("vehicle", "van")
    async with engine.begin() as connection:
        second = await service.rotate_key(connection, first.key_id, timedelta(0))
    assert (await client.get("/doors/report", headers=auth(first))).status_code == 401
    assert (await client.get("/doors/report", headers=auth(second))).status_code == 200
    async with engine.begin() as connection:
        with pytest.raises(service.AccountError, match="no valid key"):
            await service.rotate_key(connection, first.key_id, timedelta(0))


async def test_a_key_that_has_an_end_gets_no_later_one(engine: AsyncEngine, issue_key: IssueKey) -> None:
    """Neither by another rotation nor, once it is revoked, by another revocation."""
    first = await issue_key("vehicle", "van")

    async def ends() -> list[datetime | None]:
        async with engine.connect() as connection:
            stored = await repository.find_key(connection, first.key_id)
        assert stored is not None
        return [stored.expires_at, stored.revoked_at]

    async with engine.begin() as connection:
        await service.rotate_key(connection, first.key_id, timedelta(minutes=1))
    soon, _ = await ends()
    async with engine.begin() as connection:
        await service.rotate_key(connection, first.key_id, timedelta(days=1))
        await service.revoke_key(connection, first.key_id)
    once = await ends()
    assert once[0] == soon is not None
    async with engine.begin() as connection:
        await service.revoke_key(connection, first.key_id)
    assert await ends() == once


async def test_a_revoked_key_works_no_longer_than_the_cache(
    client: httpx.AsyncClient, engine: AsyncEngine, issue_key: IssueKey, auth: Auth, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert service.CACHE_SECONDS <= 5
    key, unused = await issue_key("vehicle"), await issue_key("vehicle")
    assert (await client.get("/doors/report", headers=auth(key))).status_code == 200
    async with engine.begin() as connection:
        await service.revoke_key(connection, key.key_id)
        await service.revoke_key(connection, unused.key_id)
    assert (await client.get("/doors/report", headers=auth(unused))).status_code == 401
    monkeypatch.setattr(service, "CACHE_SECONDS", 0.0)
    assert (await client.get("/doors/report", headers=auth(key))).status_code == 401


async def test_a_key_is_looked_up_once_in_a_while_and_few_are_remembered(
    engine: AsyncEngine, issue_key: IssueKey, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "_CACHE_SIZE", 2)
    asked: list[str] = []
    find = repository.find_key

    async def counted(connection: AsyncConnection, key_id: str) -> StoredKey | None:
        asked.append(key_id)
        return await find(connection, key_id)

    monkeypatch.setattr(repository, "find_key", counted)
    keys = [await issue_key("vehicle") for _ in range(3)]
    authenticator = service.Authenticator(engine)
    for index in (0, 1, 0, 0, 2, 2, 0):  # the third takes the place of the first, which was asked for before the second
        principal = await authenticator.authenticate(keys[index].key)
        assert principal is not None
        assert principal.key_id == keys[index].key_id
    assert asked == [keys[index].key_id for index in (0, 1, 2, 0)]


async def test_labels_are_taken_once(engine: AsyncEngine, issue_key: IssueKey) -> None:
    await issue_key("vehicle", "van")
    with pytest.raises(service.AccountError, match="already"):
        await issue_key("provider", "van")
    for label in ("", "   ", "a\nb", "x" * 201, "nul\0"):
        with pytest.raises(service.AccountError, match="printable"):
            await issue_key("vehicle", label)
