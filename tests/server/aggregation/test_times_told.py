"""When vehicles were where: providers are told the hour, however they ask, and admins the moment."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Any

import httpx
import pytest

from slamcu_server.accounts.times import TimesTold, hour_of

pytestmark = pytest.mark.anyio

Headers = dict[str, str]

OWN_CLOCK = {"said_at", "as_of", "at", "mapped_at", "since", "created_at"}  # of this server, not of vehicles
MINUTES = (0.31, 0.52, 0.77)  # of an hour, where the hours end in five seconds by themselves


@pytest.fixture
def policy(reports: Any) -> Any:
    return reports.KNOWN


@pytest.fixture
async def told(town: Any, reports: Any) -> None:
    """A find and a deletion, which end in one moved sign, one more find, and the cars' times within their hours."""
    for number, part in enumerate(MINUTES):
        hours = 2 * number + part
        await town.report(f"a{number}", reports.missed(1, hours=hours), reports.find(100, 0, hours=hours))
        await town.report(f"b{number}", reports.find(8, 0, hours=hours, sign="SPEED_LIMIT"))
    await town.fuse()


def times(document: Any, name: str = "") -> Iterator[tuple[str, datetime]]:
    """Find the times of a document with the names that they go by."""
    if isinstance(document, dict):
        for key, value in document.items():
            yield from times(value, key)
    elif isinstance(document, list):
        for value in document:
            yield from times(value, name)
    elif isinstance(document, str) and name not in OWN_CLOCK and re.match(r"20\d\d-\d\d-\d\dT", document):
        yield name, datetime.fromisoformat(document)


async def questions(client: httpx.AsyncClient, headers: Headers) -> dict[str, Any]:
    """Ask all that is about what vehicles did."""
    entries = (await client.get("/v1/changes", headers=headers)).json()["entries"]
    ids = sorted({entry["change"]["id"] for entry in entries})
    urls = [
        "/v1/changes",
        *(f"/v1/changes/{number}" for number in ids),
        "/v1/features?map=town",
        "/v1/features/1",
        "/v1/coverage?map=town&bbox=2,48,3,49",
    ]
    return {url: (await client.get(url, headers=headers)).raise_for_status().json() for url in urls}


@pytest.mark.usefixtures("told")
async def test_providers_are_told_the_hour_and_admins_the_moment(
    client: httpx.AsyncClient, provider: Headers, admin: Headers
) -> None:
    coarse, exact = await questions(client, provider), await questions(client, admin)
    names = set()
    for url, document in coarse.items():
        pairs = list(zip(times(document), times(exact[url]), strict=True))
        assert pairs, url
        for (name, shown), (_, true) in pairs:
            assert shown == hour_of(true), (url, name)
            names |= {name} if true != shown else set()
    assert {"moved", "new"} <= {entry["change"]["kind"] for entry in coarse["/v1/changes"]["entries"]}
    assert names == {
        "first_seen", "last_seen", "last_looked", "first_evidence", "confirmed_at",  # of changes, and of their halves
        "time", "stood_since", "fades_at",  # of explanations
        "oldest_look", "newest_look",  # of coverage
    }  # fmt: skip


async def test_no_question_tells_more_than_the_hour(
    town: Any, reports: Any, client: httpx.AsyncClient, provider: Headers, admin: Headers
) -> None:
    """Halving, with `as_of` or `not_looked_since`, and how far evidence has faded would each tell the second."""
    for place, minute in ((100, 0.2), (300, 0.9)):
        for number in range(2):
            await town.report(f"{number}", reports.find(place, 0, hours=number + minute), session=f"{place}")
    await town.report("looks", reports.seen(1, hours=0.5))
    await town.fuse()

    async def answers(headers: Headers) -> list[Any]:
        found = []
        for minute in (5, 25, 55):
            asked = {"as_of": (reports.at(1) + timedelta(minutes=minute)).isoformat()}
            told = [(await client.get(f"/v1/changes/{n}", headers=headers, params=asked)).json() for n in (1, 2)]
            found.append([(one["evidence"]["evidence_now"], len(one["evidence"]["contributions"])) for one in told])
            since = {"map": "town", "not_looked_since": (reports.at(0) + timedelta(minutes=minute)).isoformat()}
            page = (await client.get("/v1/features", headers=headers, params=since)).json()
            covered = {"map": "town", "bbox": "2,48,3,49", "since": since["not_looked_since"]}
            tiles = (await client.get("/v1/coverage", headers=headers, params=covered)).json()["tiles"]
            found[-1] += [len(page["features"]), [tile["looked_at"] for tile in tiles]]
        return found

    first, *others = await answers(provider)
    assert first[0] == first[1], "two changes of which one was seen forty minutes before the other"
    assert others == [first, first]
    exact = await answers(admin)
    assert exact[0] != exact[1] != exact[2]


def test_an_hour_is_one_of_the_clock_in_any_zone() -> None:
    when = datetime.fromisoformat("2026-05-01T10:20:30.5+05:30")
    assert TimesTold().round(when).isoformat() == "2026-05-01T09:30:00+05:30"  # 04:00 in UTC
    assert TimesTold().until(when).isoformat() == "2026-05-01T10:30:00+05:30"
    assert TimesTold().until(hour_of(when)) == hour_of(when)
    assert TimesTold(exact=True).round(when) == TimesTold(exact=True).until(when) == when
    assert TimesTold().text("2026-05-01T10:20:30.5+00:00") == "2026-05-01T10:00:00+00:00"
    assert TimesTold().text(None) is None
