"""Maps as vehicles and providers fetch them: pages of one version, watch features, and tags that spare the transfer."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.formats import load_hd_map, write_hd_map
from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_server.maps import repository
from slamcu_server.maps.bbox import BoundingBox
from slamcu_server.maps.importer import import_map
from slamcu_server.maps.tiles import tile_id, watch_tile_id

pytestmark = pytest.mark.anyio

Import = Callable[..., Awaitable[None]]


@pytest.fixture
def put_map(engine: AsyncEngine, tmp_path: Path) -> Import:
    """`await put_map("town", "2", features)`."""

    async def put(source: str, version: str, features: list[MapFeature]) -> None:
        path = tmp_path / "map.geojson"
        path.write_text("".join(write_hd_map(MapIdentity(source, version), features)))
        async with engine.begin() as connection:
            await import_map(connection, path)

    return put


async def put_candidate(engine: AsyncEngine, lon: float, lat: float, **columns: Any) -> int:
    """Insert a candidate of the first map, as the aggregation would."""
    values = {
        "map_id": 1, "feature_class": "traffic_sign", "sign": "STOP_SIGN", "cov_xx": 0.5, "cov_xy": 0.1, "cov_yy": 0.3,
        "weight_for": 1.0, "weight_against": 0.0, "standing": False, "contributors_for": 1, "contributors_against": 0,
        "passes": 1, "policy_version": "test", "first_seen": datetime(2026, 1, 1, tzinfo=UTC), **columns,
    }  # fmt: skip
    async with engine.begin() as connection:
        names = ", ".join(values)
        marks = ", ".join(f":{name}" for name in values)
        query = text(
            f"INSERT INTO candidates ({names}, founding_pass, geom) VALUES ({marks}, "
            "(SELECT coalesce(max(founding_pass), 0) + 1 FROM candidates), ST_SetSRID(ST_MakePoint(:lon, :lat), 4326)) "
            "RETURNING id"
        )
        return int((await connection.execute(query, {**values, "lon": lon, "lat": lat})).scalar_one())


def ids(answer: httpx.Response) -> list[int]:
    assert answer.status_code == 200, answer.text
    return [feature["id"] for feature in answer.json()["features"]]


async def pages(client: httpx.AsyncClient, url: str | None, headers: dict[str, str]) -> list[dict[str, Any]]:
    found = []
    while url is not None:
        answer = await client.get(url, headers=headers)
        assert answer.status_code == 200, answer.text
        found.append(answer.json())
        url = answer.json()["next"]
    return found


@pytest.mark.usefixtures("town")
async def test_the_maps_are_listed(client: httpx.AsyncClient, provider: dict[str, str], put_map: Import) -> None:
    await put_map("empty", "1", [])
    answer = await client.get("/v1/maps", headers=provider)
    assert answer.status_code == 200
    empty, town = answer.json()["maps"]
    assert empty == {"source": "empty", "version": "1", "sequence": 1, "features": 0, "bbox": None}
    assert (town["source"], town["version"], town["features"]) == ("town", "1", 5)
    assert town["bbox"] == pytest.approx([2.10137, 48.9, 2.10685, 48.9])


async def test_what_comes_out_is_what_went_in(
    client: httpx.AsyncClient, provider: dict[str, str], put_map: Import
) -> None:
    features = [
        MapFeature(3, 2.1, 48.9, sign="SPEED_LIMIT", value="80", altitude=35.5, heading_deg=87.0),
        MapFeature(12, -179.99, -33.3, feature_class="pole", existence_confidence=0.5, position_std_m=1.0),
    ]
    await put_map("A map: with@odd+names~", "2026.05.1", features)
    answer = await client.get("/v1/maps/A%20map:%20with@odd+names~/features", headers=provider)
    assert answer.headers["content-type"] == "application/geo+json"
    read = load_hd_map([answer.content])
    assert read.identity == MapIdentity("A map: with@odd+names~", "2026.05.1")
    assert [(f.object_id, f.lon, f.lat, f.sign, f.value, f.altitude, f.heading_deg) for f in read] == [
        (f.object_id, f.lon, f.lat, f.sign, f.value, f.altitude, f.heading_deg) for f in features
    ]
    assert [(f.feature_class, f.existence_confidence, f.position_std_m) for f in read] == [
        (f.feature_class, f.existence_confidence, f.position_std_m) for f in features
    ]
    assert all(f.tile_id >= 0 and not f.watched for f in read)


async def test_pages_are_whole_and_of_one_version(
    client: httpx.AsyncClient, vehicle: dict[str, str], engine: AsyncEngine, put_map: Import
) -> None:
    features = [MapFeature(number, 2.0 + number / 1000, 48.9) for number in range(1, 8)]
    await put_map("town", "1", features)
    watches = [await put_candidate(engine, 2.0, 48.9) for _ in range(5)]
    for limit in (1, 2, 3, 4, 6, 7, 8, 12, 13):
        found = await pages(client, f"/v1/maps/town/features?limit={limit}", vehicle)
        together = [feature for page in found for feature in page["features"]]
        assert all(len(page["features"]) <= limit for page in found)
        assert [f["id"] for f in together if not f["properties"].get("watch")] == list(range(1, 8))
        assert [f["id"] for f in together if f["properties"].get("watch")] == watches
    # A new version in the middle: the pages go on with the one they began with.
    first = (await client.get("/v1/maps/town/features?limit=3", headers=vehicle)).json()
    await put_map("town", "2", features[:2])
    rest = await pages(client, first["next"], vehicle)
    assert {page["map"]["version"] for page in [first, *rest]} == {"1"}
    assert [f["id"] for page in [first, *rest] for f in page["features"]][:7] == list(range(1, 8))
    assert (await client.get("/v1/maps/town/features", headers=vehicle)).json()["map"]["version"] == "2"


async def test_open_candidates_are_watch_features(
    client: httpx.AsyncClient, vehicle: dict[str, str], provider: dict[str, str], engine: AsyncEngine, put_map: Import
) -> None:
    await put_map("town", "1", [MapFeature(1, 2.1, 48.9)])
    await put_map("other", "1", [])
    watched = await put_candidate(engine, 2.2, 48.8, value="x")
    await put_candidate(engine, 2.2, 48.8, merged_into=watched)
    await put_candidate(engine, 2.2, 48.8, feature_id=1)
    await put_candidate(engine, 2.2, 48.8, map_id=2)
    answer = await client.get("/v1/maps/town/features", headers=vehicle)
    assert ids(answer) == [1, watched]
    watch = answer.json()["features"][1]
    assert watch["geometry"] == {"type": "Point", "coordinates": [2.2, 48.8]}
    assert watch["properties"] == {
        "class": "traffic_sign",
        "sign": "STOP_SIGN",
        "value": "x",
        "position_std_m": 0.632,
        "tile_id": watch_tile_id(2.2, 48.8),
        "watch": True,
        "covariance_m2": [0.5, 0.1, 0.3],
        "kind": "new",
    }
    assert [f.watched for f in load_hd_map([answer.content])] == [False, True]
    # A provider gets them when it asks; a vehicle can do without.
    assert ids(await client.get("/v1/maps/town/features", headers=provider)) == [1]
    assert ids(await client.get("/v1/maps/town/features?watch=true", headers=provider)) == [1, watched]
    assert ids(await client.get("/v1/maps/town/features?watch=false", headers=vehicle)) == [1]


async def test_a_tag_spares_the_transfer_until_something_changes(
    client: httpx.AsyncClient, vehicle: dict[str, str], provider: dict[str, str], engine: AsyncEngine, put_map: Import
) -> None:
    features = [MapFeature(number, 2.1, 48.9) for number in (1, 2, 3)]
    await put_map("town", "1", features)
    url = "/v1/maps/town/features?limit=2"

    async def fetch(headers: dict[str, str], tag: str | None = None, at: str = url) -> tuple[int, str, bytes]:
        answer = await client.get(at, headers=headers | ({"If-None-Match": tag} if tag else {}))
        return answer.status_code, answer.headers["etag"], answer.content

    _, first, content = await fetch(vehicle)
    assert content
    assert await fetch(vehicle, first) == (304, first, b"")
    assert await fetch(vehicle, f'"other", {first.removeprefix("W/")}') == (304, first, b"")
    assert (await fetch(vehicle, '"other"'))[0] == 200
    assert (await fetch(vehicle, first, at=url + "&bbox=1,1,2,2"))[0] == 200
    assert (await fetch(vehicle, first, at=url + "&watch=false"))[0] == 200

    candidate = await put_candidate(engine, 2.1, 48.9)
    status, second, _ = await fetch(vehicle, first)
    assert (status, second == first) == (200, False)
    async with engine.begin() as connection:
        await connection.execute(text("UPDATE candidates SET cov_xx = 0.2 WHERE id = :id"), {"id": candidate})
    status, third, _ = await fetch(vehicle, second)
    assert status == 200
    await put_map("town", "2", features)  # the same content under another name is another map to name in reports
    assert (await fetch(vehicle, third))[0] == 200
    # The pages of a version that is named stay good.
    status, old, _ = await fetch(provider, at=url + "&version=1")
    await put_map("town", "3", [])
    assert (await fetch(provider, old, at=url + "&version=1"))[0] == 304


async def test_a_box_selects(client: httpx.AsyncClient, provider: dict[str, str], put_map: Import) -> None:
    places = {1: (2.1, 48.9), 2: (2.2, 48.9), 3: (179.9, 0.0), 4: (-179.9, 0.0), 5: (180.0, 90.0), 6: (2.15, 48.9)}
    await put_map("town", "1", [MapFeature(number, *place) for number, place in places.items()])

    async def within(bbox: str) -> list[int]:
        return ids(await client.get("/v1/maps/town/features", params={"bbox": bbox}, headers=provider))

    assert await within("2.1,48.9,2.2,48.9") == [1, 2, 6]  # the edges belong to it
    assert await within("2.1,48.9,2.1,48.9") == [1]
    assert await within("2.1,48.9,2.15,48.9") == [1, 6]
    assert await within("2.10000001,48,2.2,49") == [2, 6]
    assert await within("179,-1,-179,1") == [3, 4]  # across the antimeridian
    assert await within("-180,-90,180,90") == [1, 2, 3, 4, 5, 6]
    assert await within("10,10,11,11") == []


@pytest.mark.parametrize(
    ("longitudes", "west", "east"),
    [
        ((179.9, -179.8), 179.9, -179.8),
        ((177.0, 180.0), 177.0, 180.0),
        ((-180.0, -179.0), -180.0, -179.0),
        ((-1.0, 2.0), -1.0, 2.0),
        ((-170.0, 20.0, 170.0), 20.0, -170.0),
        ((5.0,), 5.0, 5.0),
    ],
)
async def test_the_box_of_a_map_can_be_asked_for(  # noqa: PLR0917
    client: httpx.AsyncClient,
    provider: dict[str, str],
    put_map: Import,
    longitudes: tuple[float, ...],
    west: float,
    east: float,
) -> None:
    """Of a map on both sides of the antimeridian it is not all that is between them the other way round."""
    await put_map("fiji", "1", [MapFeature(number, lon, -16.8) for number, lon in enumerate(longitudes, start=1)])
    [told] = (await client.get("/v1/maps", headers=provider)).json()["maps"]
    assert told["bbox"] == pytest.approx([west, -16.8, east, -16.8])
    box = ",".join(map(str, told["bbox"]))
    for url in ("/v1/maps/fiji/features", "/v1/features?map=fiji"):
        answer = await client.get(url, params={"bbox": box, "map": "fiji"}, headers=provider)
        assert len(answer.json()["features"]) == len(longitudes), url


async def test_neither_a_small_box_nor_a_late_page_reads_the_whole_map(engine: AsyncEngine, put_map: Import) -> None:
    await put_map("town", "1", [])
    async with engine.begin() as connection:
        for statement in (
            "INSERT INTO features (map_id, object_id) SELECT 1, n FROM generate_series(1, 20000) AS n",
            """INSERT INTO feature_versions (feature_id, from_sequence, map_id, feature_class, existence_confidence,
                position_std_m, geom) SELECT id, 1, 1, 'pole', 0.9, 0.1,
                ST_SetSRID(ST_MakePoint(2 + id % 200 / 100.0, 48 + id / 20000.0), 4326) FROM features""",
            "ANALYZE features, feature_versions",
        ):
            await connection.execute(text(statement))

    async def rows_read(bbox: str | None, after: int) -> int:
        """How many rows of feature_versions the query touches."""
        box = BoundingBox.parse(bbox) if bbox else None
        read = text(
            "SELECT seq_tup_read + idx_tup_fetch FROM pg_stat_xact_user_tables WHERE relname = 'feature_versions'"
        )
        async with engine.connect() as connection:
            await repository.list_features(connection, 1, 1, bbox=box, after=after, limit=101)
            return int((await connection.execute(read)).scalar_one())

    assert await rows_read("2.5,48.5,2.52,48.52", 0) < 100
    assert await rows_read(None, 10_000) < 300
    assert await rows_read("2,48,4,49", 0) < 300  # all of it, page by page


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ("bbox=1,2,3", "bbox"),
        ("bbox=a,b,c,d", "bbox"),
        ("bbox=", "bbox"),
        ("bbox=nan,0,1,1", "bbox"),
        ("bbox=0,0,inf,1", "bbox"),
        ("bbox=0,0,181,1", "bbox"),
        ("bbox=0,-91,1,1", "bbox"),
        ("bbox=0,2,1,1", "bbox"),
        ("limit=0", "limit"),
        ("limit=10001", "limit"),
        ("limit=many", "limit"),
        ("after=-1", "after"),
        ("after=watch", "after"),
        ("after=99999999999999999999", "after"),
        ("after=%00", "after"),
        ("watch=perhaps", "watch"),
    ],
)
@pytest.mark.usefixtures("town")
async def test_a_bad_query_is_told_with_its_field(
    client: httpx.AsyncClient, provider: dict[str, str], query: str, field: str
) -> None:
    answer = await client.get(f"/v1/maps/town/features?{query}", headers=provider)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert [error["field"] for error in answer.json()["errors"]] == [f"query.{field}"]


@pytest.mark.parametrize(
    "path",
    [
        "nowhere/features",
        "nowhere/versions",
        "%00/features",
        "a%0Ab/features",
        "%C3%28/versions",
        "x" * 200 + "/features",
    ],
)
@pytest.mark.usefixtures("town")
async def test_an_unknown_map_is_404(client: httpx.AsyncClient, provider: dict[str, str], path: str) -> None:
    answer = await client.get(f"/v1/maps/{path}", headers=provider)
    assert answer.status_code == 404
    assert answer.json()["type"] == "urn:slamcu:problem:unknown-map"


@pytest.mark.usefixtures("town")
async def test_an_unknown_version_is_404(client: httpx.AsyncClient, provider: dict[str, str]) -> None:
    for version in ("2", "", "%00"):
        answer = await client.get(f"/v1/maps/town/features?version={version}", headers=provider)
        assert answer.status_code == 404
        assert answer.json()["type"] == "urn:slamcu:problem:unknown-map-version"


async def test_versions_are_paged_oldest_first(
    client: httpx.AsyncClient, provider: dict[str, str], put_map: Import
) -> None:
    for number in range(1, 6):
        await put_map("town", f"v{number}", [MapFeature(number, 2.1, 48.9)])
    found = await pages(client, "/v1/maps/town/versions?limit=2", provider)
    assert [len(page["versions"]) for page in found] == [2, 2, 1]
    versions = [version for page in found for version in page["versions"]]
    assert [(one["version"], one["sequence"]) for one in versions] == [(f"v{n}", n) for n in range(1, 6)]
    assert {one["origin"] for one in versions} == {"import"}


@given(lon=st.floats(-180, 180), lat=st.floats(-90, 90))
def test_tiles_are_numbers_that_tell_watch_features(lon: float, lat: float) -> None:
    number = tile_id(lon, lat)
    assert 0 <= number < 1 << 28
    assert watch_tile_id(lon, lat) == -1 - number
    west = (number >> 14) * 360 / 2**14 - 180
    assert west - 1e-9 <= lon <= west + 360 / 2**14 + 1e-9
