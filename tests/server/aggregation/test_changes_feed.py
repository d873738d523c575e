"""The feed of changes: what is said, in which order, and what it is kept quiet about."""

from __future__ import annotations

import asyncio
from typing import Any

import httpx
import pytest

from slamcu_server.aggregation.worker import drain
from slamcu_server.changes import feed
from slamcu_server.changes.belief import Kind, State

pytestmark = pytest.mark.anyio


@pytest.fixture
def policy(reports: Any) -> Any:
    """Cars that are no strangers: what is told here is not about them."""
    return reports.KNOWN


async def confirm_new(
    town: Any, reports: Any, x: float, *, cars: tuple[str, ...] = ("a", "b"), hours: float = 0
) -> None:
    for car in cars:
        await town.report(car, reports.find(x, 0, hours=hours))
    await town.fuse()


async def test_a_provider_reads_the_feed_page_by_page(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    for number in range(5):
        await confirm_new(town, reports, 100.0 * (number + 1), hours=number)
    entries = []
    url: str | None = "/v1/changes?limit=2&kind=new"
    while url is not None:
        answer = await client.get(url, headers=provider)
        assert answer.status_code == 200, answer.text
        page = answer.json()
        assert len(page["entries"]) <= 2
        entries += page["entries"]
        url = page["next"]
    assert [entry["sequence"] for entry in entries] == list(range(1, len(entries) + 1))
    assert page["last_sequence"] == len(entries)
    assert {entry["change"]["state"] for entry in entries} == {"confirmed"}
    after = await client.get(f"/v1/changes?after={page['last_sequence']}", headers=provider)
    assert after.json() == {"entries": [], "next": None, "last_sequence": page["last_sequence"]}


async def test_filters_choose_what_they_say(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    await town.report("a", reports.find(100, 0, hours=0))
    await town.fuse()
    await confirm_new(town, reports, 100, cars=("b",))
    for number in range(6):
        await town.report(f"car-{number}", reports.missed(1, hours=number))
    await town.fuse()

    async def asked(**parameters: Any) -> list[tuple[str, str]]:
        answer = await client.get("/v1/changes", params=parameters, headers=provider)
        assert answer.status_code == 200, answer.text
        return [(entry["change"]["kind"], entry["change"]["state"]) for entry in answer.json()["entries"]]

    assert await asked() == [("new", "candidate"), ("new", "confirmed"), ("deleted", "confirmed")]
    assert await asked(latest=True) == [("new", "confirmed"), ("deleted", "confirmed")]
    assert await asked(kind="deleted") == [("deleted", "confirmed")]
    assert await asked(state=["candidate", "withdrawn"]) == [("new", "candidate")]
    assert await asked(map="elsewhere") == []
    assert len(await asked(map="town")) == 3
    west, south = reports.place(50, -50).lon, reports.place(50, -50).lat
    east, north = reports.place(150, 50).lon, reports.place(150, 50).lat
    assert {kind for kind, _ in await asked(bbox=f"{west},{south},{east},{north}")} == {"new"}


@pytest.mark.parametrize("query", ["limit=0", "after=-1", "kind=gone", "state=maybe", "bbox=1,2,3", "limit=100000"])
async def test_a_wrong_query_is_named(client: httpx.AsyncClient, provider: dict[str, str], query: str) -> None:
    answer = await client.get(f"/v1/changes?{query}", headers=provider)
    assert answer.status_code == 422
    assert query.partition("=")[0] in answer.json()["detail"]


async def test_only_providers_read_changes(client: httpx.AsyncClient, vehicle: dict[str, str]) -> None:
    for path in ("/v1/changes", "/v1/changes/1", "/v1/features/1"):
        assert (await client.get(path)).status_code == 401
        assert (await client.get(path, headers=vehicle)).status_code == 403
    assert (await client.post("/v1/changes/1/review", json={"decision": "accept"}, headers=vehicle)).status_code == 403


async def test_the_feed_stays_quiet_about_more_of_the_same(town: Any, reports: Any) -> None:
    await confirm_new(town, reports, 100, cars=tuple("abcdefgh"))
    before = await town.entries()
    for number in range(20):
        await town.report("abcdefgh"[number % 8], reports.find(100, 0, hours=2 + number))
        await town.fuse()
    assert await town.entries() == before


async def test_a_slow_transaction_is_never_skipped(town: Any, reports: Any, engine: Any) -> None:
    """Whoever takes a number keeps others from a later one until its own is visible."""
    await confirm_new(town, reports, 100)
    [change] = await town.changes()
    entry = feed.Entry(change.id, change.map_id, Kind.NEW, State.CONFIRMED, 2, change.document)
    async with engine.connect() as slow:
        transaction = await slow.begin()
        await feed.append(slow, [entry])
        await town.report("c", reports.find(300, 0, hours=0))
        fast = asyncio.create_task(drain(engine, town.policy))
        done, _ = await asyncio.wait({fast}, timeout=0.3)
        assert not done
        assert [row.sequence for row in await town.entries()] == [1]
        await transaction.commit()
    await fast
    assert [row.sequence for row in await town.entries()] == [1, 2, 3]


async def test_a_transaction_that_fails_leaves_no_gap(town: Any, reports: Any, engine: Any) -> None:
    await confirm_new(town, reports, 100)
    [change] = await town.changes()
    async with engine.connect() as failing:
        transaction = await failing.begin()
        await feed.append(
            failing, [feed.Entry(change.id, change.map_id, Kind.NEW, State.CONFIRMED, 2, change.document)]
        )
        await transaction.rollback()
    await confirm_new(town, reports, 300)
    assert [row.sequence for row in await town.entries()] == [1, 2]


async def test_a_change_is_explained_by_pseudonymous_contributions(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    await confirm_new(town, reports, 100, cars=("alice", "bob"))
    await confirm_new(town, reports, 300, cars=("alice", "bob"))
    answers = [(await client.get(f"/v1/changes/{number}", headers=provider)) for number in (1, 2)]
    first, second = (answer.json() for answer in answers)
    assert answers[0].headers["etag"] == '"1-1"'
    assert first["evidence"]["would_flip"]["becomes"] == "withdrawn"
    assert first["evidence"]["would_flip"]["sentence"].endswith("by different vehicles")
    names = [{part["vehicle"] for part in document["evidence"]["contributions"]} for document in (first, second)]
    assert len(names[0]) == 2
    assert not names[0] & names[1]  # nobody can follow a vehicle from one change to another
    last = first["evidence"]["course"][-1]
    assert last["weight_for"] == pytest.approx(first["weight_for"], abs=1e-12)
    assert last["standing"]
    assert first["evidence"]["trust_version"] == first["trust_version"] == 0
    assert first["history"][0]["state"] == "confirmed"
    assert all(abs(part["position_residual_m"][0]) < 0.01 for part in first["evidence"]["contributions"])
    for document in (first, second):
        assert document["mass_exists"] + document["mass_not_exists"] + document["mass_unknown"] == pytest.approx(1.0)
        assert document["ellipse95"]["semi_major_m"] > 0


async def test_what_would_flip_does_flip(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    await confirm_new(town, reports, 100)
    document = (await client.get("/v1/changes/1", headers=provider)).json()
    needed = document["evidence"]["would_flip"]["vehicles"]
    for number in range(needed):
        assert (await town.changes())[0].state == "confirmed"
        await town.report(
            f"skeptic-{number}", reports.missed(document["watch_id"], hours=2 + number, watched=True, weight=20)
        )
        await town.fuse()
    assert (await town.changes())[0].state == "withdrawn"


async def test_an_unknown_change_is_a_404(client: httpx.AsyncClient, provider: dict[str, str]) -> None:
    answer = await client.get("/v1/changes/99", headers=provider)
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


async def test_a_feature_tells_its_evidence_and_history(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    feature_id = await town.scalar("SELECT id FROM features")
    silent = (await client.get(f"/v1/features/{feature_id}", headers=provider)).json()
    assert silent["standing"]["mass_exists"] == pytest.approx(0.95)
    assert silent["standing"]["policy_version"] is None
    for number in range(6):
        await town.report(f"car-{number}", reports.missed(1, hours=number))
    await town.report("blind", reports.blocked(1, hours=7))
    await town.fuse()
    told = (await client.get(f"/v1/maps/{town.source}/features/1", headers=provider, follow_redirects=True)).json()
    assert told["id"] == feature_id
    standing = told["standing"]
    assert (standing["stands_against"], standing["looked"], standing["blocked"]) == (True, 6, 1)
    assert told["changes"] == [{"id": 1, "kind": "deleted", "state": "confirmed"}]
    assert [version["since"] for version in told["versions"]] == ["2026.05"]
    assert (await client.get("/v1/features/999", headers=provider)).status_code == 404
