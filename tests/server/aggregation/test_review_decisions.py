"""Review: accepting makes the next map version, rejecting keeps the reason, and two reviewers never both win."""

from __future__ import annotations

import asyncio
import json
import math
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import encode_batch
from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.locks import lock_maps
from slamcu_server.database import transactions
from slamcu_server.maps.importer import import_map
from slamcu_server.retraction.marks import hold_alone

pytestmark = pytest.mark.anyio

Headers = dict[str, str]


async def confirm_new(town: Any, reports: Any, x: float = 100.0, hours: float = 0) -> None:
    for car in ("a", "b"):
        await town.report(car, reports.find(x, 0, hours=hours))
    await town.fuse()


async def confirm_deleted(town: Any, reports: Any, object_id: int = 1) -> None:
    for number in range(6):
        await town.report(f"car-{number}", reports.missed(object_id, hours=number))
    await town.fuse()


async def review(client: httpx.AsyncClient, provider: Headers, change_id: int, **body: Any) -> httpx.Response:
    etag = (await client.get(f"/v1/changes/{change_id}", headers=provider)).headers["etag"]
    return await client.post(f"/v1/changes/{change_id}/review", json=body, headers=provider | {"If-Match": etag})


async def mapped(client: httpx.AsyncClient, provider: Headers) -> tuple[str, dict[int, Any]]:
    page = (await client.get("/v1/maps/town/features?watch=true", headers=provider)).json()
    return page["map"]["version"], {
        one["id"] * (-1 if one["properties"].get("watch") else 1): one for one in page["features"]
    }


async def test_accepting_a_deletion_makes_a_map_without_the_feature(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await confirm_deleted(town, reports)
    answer = await review(client, provider, 1, decision="accept")
    assert answer.status_code == 200, answer.text
    assert answer.json()["state"] == "accepted"
    assert answer.json()["review"]["map_version"] == "2026.05+1"
    assert answer.json()["review"]["by"] == "provider"
    assert await mapped(client, provider) == ("2026.05+1", {})
    old = await client.get("/v1/maps/town/features?version=2026.05", headers=provider)
    assert [one["id"] for one in old.json()["features"]] == [1]
    # Cars with the old map go on reporting: kept with the feature, no change of a map that no longer has it.
    await town.report("late", reports.seen(1, hours=20), reports.missed(1, hours=40))
    await town.fuse()
    assert [entry.state for entry in await town.entries()] == ["confirmed", "accepted"]


async def test_a_version_without_a_name_gets_the_first_that_is_free(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    for x in (100.0, 200.0, 300.0):
        await confirm_new(town, reports, x)
    versions = []
    for change, named in ((1, {"version": "2026.05+2"}), (2, {}), (3, {})):
        answer = await review(client, provider, change, decision="accept", **named)
        assert answer.status_code == 200, answer.text
        versions.append(answer.json()["review"]["map_version"])
    assert versions == ["2026.05+2", "2026.05+3", "2026.05+4"]


async def test_accepting_a_new_feature_gives_it_the_prior_and_counts_nothing_twice(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await confirm_new(town, reports)
    [candidate] = await town.candidates()
    _, before = await mapped(client, provider)
    assert set(before) == {1, -candidate.id}
    answer = await review(client, provider, 1, decision="accept", version="2026.06")
    assert answer.status_code == 200, answer.text
    assert answer.json()["map_object_id"] == 2
    version, features = await mapped(client, provider)
    assert version == "2026.06"
    assert set(features) == {1, 2}
    assert features[2]["geometry"]["coordinates"] == pytest.approx(before[-candidate.id]["geometry"]["coordinates"])
    state = await town.feature_state(2)
    assert (state.passes, state.weight_against) == (0, 0.0)
    assert state.weight_for == pytest.approx(-math.log(0.05))
    assert await rebuild.differences(town.engine, town.policy) == []
    explained = (await client.get("/v1/changes/1", headers=provider)).json()
    assert len(explained["evidence"]["contributions"]) == 2  # archived, and still there to be asked for


async def test_cars_that_do_not_know_an_accepted_feature_speak_about_it_all_the_same(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await confirm_new(town, reports)
    [candidate] = await town.candidates()
    await review(client, provider, 1, decision="accept")
    await town.report("old-map", reports.find(100.4, 0.3, hours=3))
    await town.report("watcher", reports.seen(candidate.id, hours=4, watched=True))
    await town.report("new-map", reports.seen(2, hours=5), version="2026.05+1")
    await town.fuse()
    state = await town.feature_state(2)
    assert (state.contributors_for, state.passes) == (3, 3)
    assert await town.candidates() == []
    # but a car that has the feature in its map and finds another thing there means another thing
    await town.report("new-map", reports.find(100.4, 0.3, hours=6), version="2026.05+1")
    await town.fuse()
    assert len(await town.candidates()) == 1


async def test_ids_stay_the_same_over_review_and_import(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers, tmp_path: Path
) -> None:
    await confirm_new(town, reports)
    await review(client, provider, 1, decision="accept")
    _, features = await mapped(client, provider)
    ids = {key: one["properties"]["feature_id"] for key, one in features.items()}
    document = {
        "type": "FeatureCollection",
        "map": {"source": "town", "version": "2026.07"},
        "features": [
            {"type": "Feature", "id": key, "geometry": one["geometry"], "properties": {"class": "traffic_sign"}}
            for key, one in features.items()
        ],
    }
    path = tmp_path / "town.geojson"
    path.write_text(json.dumps(document))
    async with town.engine.begin() as connection:
        await import_map(connection, path)
    version, again = await mapped(client, provider)
    assert version == "2026.07"
    assert {key: one["properties"]["feature_id"] for key, one in again.items()} == ids
    await confirm_new(town, reports, x=300.0)
    await review(client, provider, 2, decision="accept")
    version, features = await mapped(client, provider)
    assert (version, set(features)) == ("2026.07+1", {1, 2, 3})


async def test_a_rejection_keeps_its_reason_until_the_evidence_has_left_and_come_again(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    town.policy = reports.KNOWN
    await confirm_new(town, reports)
    [candidate] = await town.candidates()
    answer = await review(client, provider, 1, decision="reject", reason="a poster of a sign")
    assert answer.json()["review"]["reason"] == "a poster of a sign"
    await town.report("c", reports.find(100, 0, hours=5))
    await town.fuse()
    assert [entry.state for entry in await town.entries()] == ["confirmed", "rejected"]
    for number in range(4):
        await town.report(f"miss-{number}", reports.missed(candidate.id, hours=10 + number, watched=True))
    await town.fuse()
    assert len(await town.entries()) == 2
    for number in range(5):
        await town.report(f"see-{number}", reports.seen(candidate.id, hours=30 + number, watched=True))
    await town.fuse()
    assert [(entry.change_id, entry.state) for entry in await town.entries()] == [
        (1, "confirmed"),
        (1, "rejected"),
        (2, "confirmed"),
    ]
    assert (await town.changes())[0].document["review"]["reason"] == "a poster of a sign"


async def test_a_review_names_the_revision_it_is_about(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    town.policy = reports.KNOWN
    await town.report("a", reports.find(100, 0, hours=0))
    await town.fuse()
    stale = (await client.get("/v1/changes/1", headers=provider)).headers["etag"]
    await town.report("b", reports.find(100, 0, hours=1))
    await town.fuse()
    path = "/v1/changes/1/review"
    for headers, status in (({}, 428), ({"If-Match": "*"}, 428), ({"If-Match": stale}, 412), ({"If-Match": "no"}, 412)):
        answer = await client.post(path, json={"decision": "accept"}, headers=provider | headers)
        assert answer.status_code == status, answer.text
        assert answer.headers["content-type"] == "application/problem+json"
    assert (await town.changes())[0].state == "confirmed"
    for body in (
        {"decision": "reject"},
        {"decision": "maybe"},
        {"decision": "reject", "reason": "x", "version": "y"},
        {},
    ):
        assert (await client.post(path, json=body, headers=provider | {"If-Match": '"1-2"'})).status_code == 422
    assert (await review(client, provider, 1, decision="accept", version="2026.05")).status_code == 409
    assert (await review(client, provider, 1, decision="accept")).status_code == 200
    assert (await review(client, provider, 1, decision="accept")).status_code == 409
    answer = await client.post(
        "/v1/changes/77/review", json={"decision": "accept"}, headers=provider | {"If-Match": "x"}
    )
    assert answer.status_code == 404


async def test_of_two_reviewers_one_wins(town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers) -> None:
    await confirm_new(town, reports)
    headers = provider | {"If-Match": '"1-1"'}
    bodies = [{"decision": "accept"}, {"decision": "reject", "reason": "no"}] * 3
    answers = await asyncio.gather(
        *(client.post("/v1/changes/1/review", json=body, headers=headers) for body in bodies)
    )
    assert sorted(answer.status_code for answer in answers) == [200, 412, 412, 412, 412, 412]
    assert len(await town.entries()) == 2


async def test_reviews_of_different_changes_at_once_make_one_version_each(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    for number in range(4):
        await confirm_new(town, reports, x=100.0 * (number + 1))
    answers = await asyncio.gather(*(review(client, provider, number, decision="accept") for number in (1, 2, 3, 4)))
    assert sorted(answer.json()["review"]["map_version"] for answer in answers) == [
        "2026.05+1",
        "2026.05+2",
        "2026.05+3",
        "2026.05+4",
    ]
    assert sorted(answer.json()["map_object_id"] for answer in answers) == [2, 3, 4, 5]
    assert [entry.sequence for entry in await town.entries()] == list(range(1, 9))


async def test_reports_during_a_review_are_neither_lost_nor_counted_twice(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await confirm_new(town, reports)
    for number in range(20):
        await town.report(f"later-{number}", reports.find(100.1, 0, hours=1 + number))
    answer, *_ = await asyncio.gather(
        client.post("/v1/changes/1/review", json={"decision": "accept"}, headers=provider | {"If-Match": '"1-1"'}),
        *(town.fuse_some(batch_size=2) for _ in range(2)),
    )
    assert answer.status_code in {200, 412}, answer.text
    await town.fuse()
    assert await rebuild.differences(town.engine, town.policy) == []
    counted = await town.rows(
        "SELECT (feature_id IS NOT NULL)::int + (archived OR candidate_id IS NOT NULL)::int AS n FROM passes"
    )
    assert len(counted) == 22
    assert {row.n for row in counted} == {1}


async def test_reviews_and_retractions_that_wait_for_an_import_give_up_and_nothing_else_does(
    *, town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers, admin: Headers, engine: AsyncEngine
) -> None:
    await confirm_new(town, reports)
    async with engine.begin() as connection:
        await lock_maps(connection)
        await hold_alone(connection)
        waiting = [asyncio.create_task(review(client, provider, 1, decision="reject", reason="x")) for _ in range(11)]
        retract = {"session_id": "s", "reason": "x"}
        waiting.append(asyncio.create_task(client.post("/v1/evidence/retract", json=retract, headers=admin)))
        await asyncio.sleep(1.0)  # each has a connection of the pool, or waits for one
        assert (await client.get("/readyz")).status_code == 200
        answers = await asyncio.wait_for(asyncio.gather(*waiting), 30)
    for answer in answers:
        assert answer.status_code == 503
        assert answer.headers["retry-after"]
        assert answer.json()["type"] == "urn:slamcu:problem:database-unavailable"
    assert (await review(client, provider, 1, decision="reject", reason="x")).status_code == 200


async def test_decisions_that_wait_leave_connections_to_reads_and_reports(
    *,
    town: Any,
    reports: Any,
    client: httpx.AsyncClient,
    vehicle: Headers,
    provider: Headers,
    engine: AsyncEngine,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(transactions, "_LOCK_TIMEOUT", text("SET LOCAL lock_timeout = '60s'"))
    monkeypatch.setattr(transactions, "_PATIENCE_S", 60)
    await confirm_new(town, reports)
    etag = (await client.get("/v1/changes/1", headers=provider)).headers["etag"]
    seen = reports.seen(1, hours=1.0)
    body = encode_batch([ReportMessage("s", 1, (seen,), map_identity=MapIdentity("town", "2026.05"))])
    told = vehicle | {"Content-Type": "application/x-protobuf"}
    async with engine.begin() as connection:
        await lock_maps(connection)
        headers, decision = provider | {"If-Match": etag}, {"decision": "reject", "reason": "x"}
        url = "/v1/changes/1/review"
        waiting = [asyncio.create_task(client.post(url, json=decision, headers=headers)) for _ in range(12)]
        for _ in range(200):
            await asyncio.sleep(0.05)
            if await connection.scalar(_WAITING) >= 3:
                break
        await asyncio.sleep(1.0)  # for more of them to wait, if they may
        beside = [client.get("/readyz"), *(client.get("/v1/maps", headers=provider) for _ in range(20))]
        beside += [client.post("/v1/data-messages", content=body, headers=told) for _ in range(5)]
        answers = await asyncio.wait_for(asyncio.gather(*beside), 8)
        assert {answer.status_code for answer in answers} == {200, 202}
        assert not any(task.done() for task in waiting)
        assert await connection.scalar(_WAITING) == 3
    assert sorted(answer.status_code for answer in await asyncio.gather(*waiting)) == [200, *11 * [412]]


_WAITING = text("SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND NOT granted")
