"""Two providers on one server: to a key that is bound to maps another provider's map is none at all."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from dataclasses import replace
from datetime import timedelta
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.hd_map import MapIdentity
from slamcu_core.sensoris import join_batch, serialize_message
from slamcu_server.accounts import service
from slamcu_server.accounts.schemas import ALL_MAPS, IssuedKey, MapScope

pytestmark = pytest.mark.anyio

Headers = dict[str, str]
IssueKey = Callable[..., Awaitable[IssuedKey]]
Auth = Callable[[IssuedKey], Headers]

BOX = "2.0,48.8,2.3,49.0"


@pytest.fixture
async def two_maps(town: Any, engine: AsyncEngine, reports: Any) -> None:
    """The maps "town" and "road", alike; change 1 is about the town, change 2 about the road."""
    road = type(town)(engine, town.policy, source="road")
    await road.import_map()
    for number, one in enumerate((town, road)):
        for car in ("a", "b"):
            await one.report(f"{car}{number}", reports.find(100, 0, hours=0))
        await one.fuse()
    sources = await town.rows("SELECT m.source FROM changes c JOIN maps m ON m.id = c.map_id ORDER BY c.id")
    assert [row.source for row in sources] == ["town", "road"]


@pytest.fixture
async def townsman(issue_key: IssueKey, auth: Auth) -> Headers:
    return auth(await issue_key("provider", "townsman", maps=["town"]))


@pytest.fixture
async def roadman(issue_key: IssueKey, auth: Auth) -> Headers:
    return auth(await issue_key("provider", "roadman", maps=["road"]))


# What each operation answers for a map, by {map}, {change} and {feature}; None: it is about no map.
QUESTIONS: dict[tuple[str, str], str | None] = {
    ("get", "/v1/maps/{source}/versions"): "/v1/maps/{map}/versions",
    ("get", "/v1/maps/{source}/features"): "/v1/maps/{map}/features?watch=true",
    ("get", "/v1/maps/{source}/features/{object_id}"): "/v1/maps/{map}/features/1",
    ("get", "/v1/features"): "/v1/features?map={map}",
    ("get", "/v1/features/{feature_id}"): "/v1/features/{feature}",
    ("get", "/v1/coverage"): "/v1/coverage?map={map}&bbox=" + BOX,
    ("get", "/v1/changes/{change_id}"): "/v1/changes/{change}",
    ("post", "/v1/changes/{change_id}/review"): "/v1/changes/{change}/review",
    ("get", "/v1/maps"): None,  # lists: the test below
    ("get", "/v1/changes"): None,
    ("post", "/v1/data-messages"): None,
    ("get", "/v1/policies"): None,  # of all maps alike
    ("get", "/v1/policies/{version}"): None,
    ("post", "/v1/evidence/retract"): None,  # admins, who are bound to nothing
    ("get", "/v1/evidence/retractions"): None,
    ("get", "/v1/evidence/retractions/{retraction_id}"): None,
    ("post", "/v1/evidence/retractions/{retraction_id}/undo"): None,
}
ACCEPT = {"decision": "accept"}


async def test_no_operation_is_forgotten(app: FastAPI) -> None:
    keyed = {
        (method, path)
        for path, item in app.openapi()["paths"].items()
        for method, operation in item.items()
        if "security" in operation
    }
    assert keyed == set(QUESTIONS)


@pytest.mark.usefixtures("two_maps")
@pytest.mark.parametrize("operation", [one for one, question in QUESTIONS.items() if question], ids=" ".join)
async def test_what_another_provider_has_is_not_there(
    client: httpx.AsyncClient, town: Any, townsman: Headers, provider: Headers, operation: tuple[str, str]
) -> None:
    """The answer is that to what no map has, word for word but for the name: not even that it exists is told."""
    question = QUESTIONS[operation] or ""
    rows = await town.rows("SELECT f.id FROM features f JOIN maps m ON m.id = f.map_id ORDER BY m.source DESC")
    mine, other = [row.id for row in rows]

    async def ask(headers: Headers, name: str, change: int, feature: int) -> httpx.Response:
        url = question.format(map=name, change=change, feature=feature)
        if operation[0] == "get":
            return await client.get(url, headers=headers)
        tag = {"If-Match": f'"{change}-1"'}
        return await client.post(url, json={"decision": "reject", "reason": "not so"}, headers=headers | tag)

    hidden, absent = await ask(townsman, "road", 2, other), await ask(townsman, "atlantis", 99, 99)
    assert (hidden.status_code, absent.status_code) == (404, 404)
    told = re.sub("road|\\b2\\b", "…", hidden.text), re.sub("atlantis|\\b99\\b", "…", absent.text)
    assert told[0].replace(str(other), "…") == told[1]
    assert (await ask(townsman, "town", 1, mine)).status_code in {200, 307}
    assert (await ask(provider, "road", 2, other)).status_code in {200, 307}, "a key that is bound to nothing"


@pytest.mark.usefixtures("two_maps")
async def test_lists_hold_ones_own_maps_only(
    client: httpx.AsyncClient, townsman: Headers, provider: Headers, issue_key: IssueKey, auth: Auth
) -> None:
    both = auth(await issue_key("provider", "both", maps=["road", "town", "not here yet"]))
    for headers, own in ((townsman, ["town"]), (provider, ["road", "town"]), (both, ["road", "town"])):
        maps = (await client.get("/v1/maps", headers=headers)).json()["maps"]
        assert [one["source"] for one in maps] == own
        for query in ("", "?latest=true", "?map=town", "?map=road", "?bbox=" + BOX):
            page = (await client.get(f"/v1/changes{query}", headers=headers)).json()
            expected = [one for one in own if not query.startswith("?map=") or query == f"?map={one}"]
            assert sorted(entry["change"]["map"] for entry in page["entries"]) == expected, query
            assert page["last_sequence"] == 2, "a follower goes on past what is not its own"


@pytest.mark.usefixtures("two_maps")
async def test_each_accepts_into_its_own_map(client: httpx.AsyncClient, townsman: Headers, roadman: Headers) -> None:
    for change in (1, 2):
        for headers, own in ((townsman, 1), (roadman, 2)):
            tag = {"If-Match": f'"{change}-1"'}
            answer = await client.post(f"/v1/changes/{change}/review", json=ACCEPT, headers=headers | tag)
            assert answer.status_code == (200 if change == own else 404), answer.text
    for headers in (townsman, roadman):
        [told] = (await client.get("/v1/maps", headers=headers)).json()["maps"]
        assert (told["version"], told["features"]) == ("2026.05+1", 2)


@pytest.mark.usefixtures("two_maps")
async def test_a_car_that_is_bound_reports_about_its_maps_only(
    client: httpx.AsyncClient, issue_key: IssueKey, auth: Auth, make_report: Callable[..., Any]
) -> None:
    car = auth(await issue_key("vehicle", "van", maps=["town"]))
    sent = [
        replace(make_report(number), map_identity=MapIdentity(source, "2026.05"))
        for number, source in enumerate(("town", "road", "atlantis"), start=1)
    ]
    answer = await client.post(
        "/v1/data-messages",
        content=join_batch([serialize_message(one) for one in sent]),
        headers=car | {"Content-Type": "application/x-protobuf"},
    )
    assert answer.status_code == 202, answer.text
    assert answer.json()["accepted"] == 1
    rejected = [(one["index"], one["reason"]) for one in answer.json()["rejected"]]
    assert rejected == [(1, "unknown-map"), (2, "unknown-map")]


@pytest.mark.usefixtures("two_maps")
async def test_a_binding_holds_for_all_keys_of_the_account_and_can_be_changed(
    client: httpx.AsyncClient, engine: AsyncEngine, issue_key: IssueKey, auth: Auth, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "CACHE_SECONDS", 0.0)
    first = await issue_key("provider", "townsman", maps=["town"])
    async with engine.begin() as connection:
        keys = [first, await service.add_key(connection, "townsman")]
        keys.append(await service.rotate_key(connection, first.key_id, timedelta(hours=1)))

    async def own(key: IssuedKey) -> list[str]:
        return [one["source"] for one in (await client.get("/v1/maps", headers=auth(key))).json()["maps"]]

    assert [await own(key) for key in keys] == [["town"]] * 3
    for scope, seen in ((MapScope(frozenset({"road"})), ["road"]), (ALL_MAPS, ["road", "town"])):
        async with engine.begin() as connection:
            await service.bind_account(connection, "townsman", scope)
        assert [await own(key) for key in keys] == [seen] * 3
    await issue_key("admin", "root")
    for label, name, told in (("root", "town", "admin"), ("nobody", "town", "no account"), ("townsman", "", "name")):
        async with engine.begin() as connection:
            with pytest.raises(service.AccountError, match=told):
                await service.bind_account(connection, label, MapScope(frozenset({name})))
    async with engine.connect() as connection:
        bound = await connection.execute(text("SELECT count(*) FROM accounts WHERE maps IS NOT NULL"))
        assert bound.scalar_one() == 0
