"""Retractions over HTTP: who may ask, a dry run, the request and its undoing, and what is refused."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from slamcu_server.retraction import corrections

pytestmark = pytest.mark.anyio


async def test_a_retraction_over_the_api(
    client: httpx.AsyncClient, admin: Any, provider: Any, town: Any, reports: Any
) -> None:
    told = reports.missed(1, hours=0.0), reports.find(40.0, 9.0, hours=0.0)
    await town.report("van", *told, software_version="4.2")
    await town.fuse()
    asked = {"contributor": "van", "reason": "loose camera", "dry_run": True}
    url = "/v1/evidence/retract"
    assert (await client.post(url, json=asked, headers=provider)).status_code == 403
    dry = await client.post(url, json=asked, headers=admin)
    assert (dry.status_code, dry.json()["passes"], dry.json()["features"], dry.json()["candidates"]) == (200, 2, 1, 1)
    made = await client.post(url, json=asked | {"dry_run": False}, headers=admin)
    assert (made.status_code, made.json()["state"], made.json()["requested_by"]) == (202, "requested", "admin")
    again = await client.post(url, json=asked | {"dry_run": False}, headers=admin)
    assert (again.status_code, again.json()["id"]) == (200, made.json()["id"])
    await corrections.correct_all(town.engine, town.policy)
    one = f"/v1/evidence/retractions/{made.json()['id']}"
    done = (await client.get(one, headers=admin)).json()
    assert (done["state"], done["passes"], done["reason"]) == ("applied", 2, "loose camera")
    assert "retained window" in done["exactness"]
    for _ in range(2):
        undone = await client.post(f"{one}/undo", json={"reason": "it was not"}, headers=admin)
        assert (undone.status_code, undone.json()["undone_by"]) == (202, "admin")
    await corrections.correct_all(town.engine, town.policy)
    listed = (await client.get("/v1/evidence/retractions", params={"limit": 1}, headers=admin)).json()
    assert [(each["state"], each["undo_reason"]) for each in listed["retractions"]] == [("undone", "it was not")]
    assert listed["next"] is None
    for wrong, status in (
        ({"reason": "x"}, 422),
        ({"contributor": "nobody", "reason": "x"}, 404),
        ({"contributor": "van"}, 422),
        ({"fleet_id": "x\u0000", "reason": "x"}, 422),
        ({"event_from": "2026-05-02T00:00:00Z", "event_until": "2026-05-01T00:00:00Z", "reason": "x"}, 422),
    ):
        refused = await client.post(url, json=wrong, headers=admin)
        assert (refused.status_code, refused.headers["content-type"]) == (status, "application/problem+json")
    assert (await client.get("/v1/evidence/retractions/99", headers=admin)).status_code == 404
