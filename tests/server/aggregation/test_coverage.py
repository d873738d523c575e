"""What the fleet has looked at, feature by feature and tile by tile, and under which policy it was judged."""

from __future__ import annotations

from typing import Any

import httpx
import pytest
from sqlalchemy import text

from slamcu_server.aggregation.policy import remember_policy
from slamcu_server.maps.tiles import tile_at, tile_bounds

pytestmark = pytest.mark.anyio

Headers = dict[str, str]
BOX = "2.0,48.8,2.2,49.0"


@pytest.fixture
async def road(engine: Any, town: Any) -> Any:
    """Signs 1 to 4 over some kilometres, of which the first two stand in one tile."""
    made = type(town)(engine, source="road")
    await made.import_map([(0.0, 0.0), (40.0, 0.0), (3000.0, 0.0), (6000.0, 0.0)])
    return made


async def driven(road: Any, reports: Any) -> None:
    """Sign 1 is seen, 2 is gone, 3 always hidden, 4 never passed."""
    for number in range(6):
        await road.report(
            f"car-{number}",
            reports.seen(1, hours=number),
            reports.missed(2, hours=number),
            reports.blocked(3, hours=number),
        )
    await road.fuse()


async def test_coverage_tells_by_tile_what_need_not_be_surveyed(
    road: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await driven(road, reports)
    parameters = {"map": "road", "bbox": BOX, "since": reports.at(0).isoformat()}
    answer = await client.get("/v1/coverage", headers=provider, params=parameters)
    assert answer.status_code == 200, answer.text
    tiles = {(tile["x"], tile["y"]): tile for tile in answer.json()["tiles"]}
    assert sum(tile["features"] for tile in tiles.values()) == 4
    here = tiles[tile_at(14, 2.1, 48.9)]
    counts = ("features", "verified", "looked_at", "contradicted", "never_looked", "looks", "could_not_see")
    assert [here[name] for name in counts] == [2, 1, 2, 1, 0, 12, 0]
    assert here["newest_look"] == reports.at(5).isoformat()
    hidden, passed_by = (tiles[tile_at(14, reports.place(x, 0).lon, 48.9)] for x in (3000.0, 6000.0))
    assert [hidden[name] for name in ("never_looked", "always_hidden", "could_not_see")] == [1, 1, 6]
    assert [passed_by[name] for name in ("never_looked", "always_hidden", "oldest_look")] == [1, 0, None]
    later = await client.get("/v1/coverage", headers=provider, params=parameters | {"since": reports.at(9).isoformat()})
    assert sum(tile["verified"] for tile in later.json()["tiles"]) == 0


async def test_what_has_faded_contradicts_nothing(
    road: Any, reports: Any, engine: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await driven(road, reports)
    parameters = {"map": "road", "bbox": BOX}

    async def told() -> tuple[int, list[bool]]:
        tiles = (await client.get("/v1/coverage", headers=provider, params=parameters)).json()["tiles"]
        listed = (await client.get("/v1/features?map=road", headers=provider)).json()["features"]
        return sum(tile["contradicted"] for tile in tiles), [one["stands_against"] for one in listed]

    assert await told() == (1, [False, True, False, False])
    async with engine.begin() as connection:
        await connection.execute(text("UPDATE feature_states SET fades_at = now() - interval '1 second'"))
    assert await told() == (0, [False, False, False, False])


@pytest.mark.parametrize(
    ("parameters", "status", "named"),
    [
        ({"bbox": BOX}, 422, "map"),
        ({"map": "road"}, 422, "bbox"),
        ({"map": "nowhere", "bbox": BOX}, 404, "nowhere"),
        ({"map": "road", "bbox": "-180,-80,180,80"}, 422, "tiles"),
        ({"map": "road", "bbox": "170,-80,-170,80", "zoom": "12"}, 422, "tiles"),
        ({"map": "road", "bbox": BOX, "since": "yesterday"}, 422, "since"),
    ],
)
async def test_a_wrong_question_is_named(
    *, road: Any, client: httpx.AsyncClient, provider: Headers, parameters: dict[str, str], status: int, named: str
) -> None:
    answer = await client.get("/v1/coverage", headers=provider, params=parameters)
    assert (answer.status_code, named in answer.json()["detail"]) == (status, True), answer.text


async def test_the_antimeridian_is_no_edge(road: Any, client: httpx.AsyncClient, provider: Headers) -> None:
    answer = await client.get(
        "/v1/coverage", headers=provider, params={"map": "road", "bbox": "179.9,-1,-179.9,1", "zoom": "12"}
    )
    assert (answer.status_code, answer.json()["tiles"]) == (200, [])


async def test_each_feature_tells_when_it_was_looked_at(
    road: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    await driven(road, reports)
    told: list[Any] = []
    url: str | None = "/v1/features?map=road&limit=3"
    while url is not None:
        page = (await client.get(url, headers=provider)).json()
        told += page["features"]
        url = page["next"]
    assert [(one["object_id"], one["looked"], one["could_not_see"], one["stands_against"]) for one in told] == [
        (1, 6, 0, False),
        (2, 6, 0, True),
        (3, 0, 6, False),
        (4, 0, 0, False),
    ]
    assert [one["last_seen"] is not None for one in told] == [True, False, False, False]
    unseen = await client.get(
        "/v1/features", headers=provider, params={"map": "road", "not_looked_since": reports.at(0).isoformat()}
    )
    assert [one["object_id"] for one in unseen.json()["features"]] == [3, 4]


async def test_what_is_not_kept_any_more_is_still_counted(
    road: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    # One car sees the sign, and then more cars than a window holds do not.
    await road.report("first", reports.seen(1, hours=0))
    for number in range(80):
        await road.report(f"car-{number}", reports.missed(1, hours=2 * (1 + number)), reports.blocked(1, hours=2))
    await road.fuse()
    state = await road.feature_state(1)
    assert state.passes < 80
    feature_id = await road.scalar(
        "SELECT f.id FROM features f JOIN maps m ON m.id = f.map_id WHERE m.source = 'road' AND object_id = 1"
    )
    standing = (await client.get(f"/v1/features/{feature_id}", headers=provider)).json()["standing"]
    assert (standing["looked_ever"], standing["could_not_see_ever"]) == (81, 80)
    assert standing["last_seen"] == reports.at(0).isoformat()


async def test_each_change_names_a_policy_that_can_be_read(
    road: Any, reports: Any, client: httpx.AsyncClient, provider: Headers
) -> None:
    async with road.engine.begin() as connection:
        await remember_policy(connection, road.policy)
    await driven(road, reports)
    feed = (await client.get("/v1/changes", headers=provider)).json()
    version = feed["entries"][-1]["change"]["policy_version"]
    told = (await client.get(f"/v1/policies/{version}", headers=provider)).json()
    assert told["document"]["default"]["contributors_deleted"] == road.policy.default.contributors_deleted
    listed = (await client.get("/v1/policies", headers=provider)).json()
    assert version in {one["version"] for one in listed["policies"]}
    assert listed["in_force"] == road.policy.version
    assert (await client.get("/v1/policies/0123456789ab", headers=provider)).status_code == 404
    assert (await client.get("/v1/policies/none", headers=provider)).status_code == 422


def test_tiles_hold_what_lies_in_them() -> None:
    for lon, lat in ((2.1, 48.9), (-180.0, -85.0), (179.9999, 85.0), (0.0, 0.0)):
        for zoom in (0, 5, 14):
            west, south, east, north = tile_bounds(zoom, *tile_at(zoom, lon, lat))
            assert west <= lon <= east
            assert south - 1e-9 <= lat <= north + 1e-9
