"""What nobody has looked at for long is not served as confirmed for ever."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from slamcu_core.aggregation import ClassPolicy, Policy
from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.fading import fade

pytestmark = pytest.mark.anyio


@pytest.fixture
def policy(reports: Any) -> Any:
    """Cars that are no strangers: what is told here is not about them."""
    return reports.KNOWN


LONG_AGO = -24.0 * 365 * 5  # hours before what the town calls now


async def stale(town: Any, reports: Any) -> None:
    """A new sign that two cars saw years ago, another that one saw, and traffic elsewhere today."""
    for car in ("a", "b"):
        await town.report(car, reports.find(100, 0, hours=LONG_AGO))
    await town.report("c", reports.find(300, 0, hours=LONG_AGO))
    await town.fuse()
    assert [change.state for change in await town.changes()] == ["confirmed", "candidate"]


async def test_the_feed_learns_that_a_belief_has_faded(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    await stale(town, reports)
    assert await fade(town.engine, town.policy) == 0  # the fleet's time has not moved on
    await town.report("d", reports.seen(1, hours=0))
    await town.fuse()
    assert await fade(town.engine, town.policy) == 2
    assert [(row.state, row.document["withdrawn_because"]) for row in await town.changes()] == [
        ("withdrawn", "faded"),
        ("withdrawn", "faded"),
    ]
    assert await fade(town.engine, town.policy) == 0
    # Neither a look that told nothing nor a rebuild brings back what has faded.
    [first, _] = await town.candidates()
    await town.report("e", reports.seen(first.id, hours=1, weight=0.001, watched=True))
    await town.fuse()
    assert await rebuild.rebuild(town.engine, town.policy) == 0
    assert await rebuild.differences(town.engine, town.policy) == []
    # A car that looks does.
    await town.report("f", reports.seen(first.id, hours=2, watched=True))
    await town.fuse()
    assert (await town.changes())[0].state == "confirmed"


async def test_what_hardly_fades_fades_after_the_calendar(town: Any, reports: Any) -> None:
    town.policy = Policy(ClassPolicy(half_life_days=1e9, strangers_more=0))
    await stale(town, reports)
    assert {row.fades_at for row in await town.candidates()} == {None}


async def test_an_explanation_reads_the_evidence_as_of_a_time(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: dict[str, str]
) -> None:
    await stale(town, reports)

    async def explained(hours: float) -> Any:
        parameters = {"as_of": reports.at(hours).isoformat()}
        return (await client.get("/v1/changes/1", headers=provider, params=parameters)).json()["evidence"]

    fresh, late, before = await explained(LONG_AGO + 1), await explained(0), await explained(LONG_AGO - 1)
    assert (fresh["stands"], late["stands"], before["stands"]) == (True, False, False)
    assert fresh["evidence_now"]["mass_exists"] > 0.8
    assert late["evidence_now"]["mass_exists"] < town.policy.default.leave
    assert before["contributions"] == []
    assert fresh["fades_at"] == late["fades_at"] is not None
    assert reports.at(LONG_AGO).isoformat() < fresh["fades_at"] < reports.at(0).isoformat()
    answer = await client.get("/v1/changes/1?as_of=2026-05-01", headers=provider)
    assert answer.status_code == 422  # a time without a zone is no moment


async def test_an_explanation_as_of_a_time_keeps_what_a_car_had_said_by_then(
    town: Any, reports: Any, client: httpx.AsyncClient, admin: dict[str, str]
) -> None:
    """Though the car said more within the same hour, and both count as one contribution afterwards."""
    for car in ("a", "b"):
        await town.report(car, reports.find(100, 0, hours=0, weight=1.0), reports.find(100, 0, hours=0.5, weight=1.0))
    await town.fuse()

    async def told(hours: float) -> list[tuple[int, float]]:
        parameters = {"as_of": reports.at(hours).isoformat()}
        evidence = (await client.get("/v1/changes/1", headers=admin, params=parameters)).json()["evidence"]
        return [(one["passes"], one["weight_for"]) for one in evidence["contributions"]]

    then, now = await told(0.25), await told(1.0)
    assert ([passes for passes, _ in then], [passes for passes, _ in now]) == ([1, 1], [2, 2])
    assert then[0][1] < now[0][1]
