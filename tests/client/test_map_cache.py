from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest

from slamcu_client import (
    AnswerError,
    AuthenticationError,
    MapCache,
    MapUnavailableError,
    Server,
)
from slamcu_core.hd_map import MapIdentity

PAGE = 3


def feature(object_id: int, tile_id: int | None = None) -> dict:
    return {
        "type": "Feature",
        "id": object_id,
        "geometry": {"type": "Point", "coordinates": [2.1 + 0.001 * object_id, 48.9]},
        "properties": {
            "class": "traffic_sign",
            "sign": "SPEED_LIMIT",
            "value": "80",
            **({} if tile_id is None else {"tile_id": tile_id}),
        },
    }


class Town:
    """A map in pages of three features, with an ETag on each."""

    def __init__(self, faults) -> None:
        self.faults = faults
        self.version = "v1"
        self.features = [feature(i) for i in range(1, 8)] + [feature(1, tile_id=-1)]
        self.sent: list[int] = []  # statuses
        self.queries: list[dict[str, str]] = []
        self.prefix = ""

    def __call__(self, query: dict[str, str], headers: dict[str, str]):
        self.queries.append(query)
        start = int(query.get("after", "0"))
        stop = start + PAGE
        document = {
            "type": "FeatureCollection",
            "map": {"source": "town", "version": self.version},
            "features": self.features[start:stop],
            "next": None,
        }
        if stop < len(self.features):
            document["next"] = f"{self.prefix}/v1/maps/town/features?watch=true&after={stop}"
        etag = f'"{hash(json.dumps(document))}"'
        if headers.get("if-none-match") == etag:
            self.sent.append(304)
            return self.faults.Answer(304, headers={"ETag": etag})
        self.sent.append(200)
        return self.faults.Answer(200, document, {"ETag": etag})


@pytest.fixture
def town(fake, faults) -> Town:
    fake.pages = Town(faults)
    return fake.pages


@pytest.fixture
def cache(server: Server, tmp_path: Path) -> MapCache:
    return MapCache(tmp_path / "map.geojson", server, "town")


def object_ids(hd_map) -> list[tuple[bool, int]]:
    return [(one.watched, one.object_id) for one in hd_map]


WHOLE = [(False, i) for i in range(1, 8)] + [(True, 1)]


def test_all_pages_make_one_map_with_the_watch_features(town: Town, cache: MapCache) -> None:
    snapshot = cache.refresh()
    assert snapshot.fresh
    assert object_ids(snapshot.hd_map) == WHOLE
    assert snapshot.hd_map.identity == MapIdentity("town", "v1")
    assert all(query["watch"] == "true" and query["path"] == "/v1/maps/town/features" for query in town.queries)
    assert json.loads(cache.path.read_text())["type"] == "FeatureCollection"
    assert object_ids(cache.load().hd_map) == WHOLE


def test_what_has_not_changed_is_not_sent_again(town: Town, cache: MapCache) -> None:
    first = cache.refresh()
    before = cache.path.stat().st_mtime_ns
    again = cache.refresh()
    assert town.sent == [200] * 3 + [304] * 3
    assert again.fresh
    assert again.fetched_at == first.fetched_at
    assert cache.path.stat().st_mtime_ns == before
    assert object_ids(again.hd_map) == WHOLE


def test_a_new_watch_feature_on_the_last_page_is_found(town: Town, cache: MapCache) -> None:
    cache.refresh()
    town.features.append(feature(2, tile_id=-1))
    assert object_ids(cache.refresh().hd_map) == [*WHOLE, (True, 2)]
    assert town.sent == [200] * 3 + [304, 304, 200]


def test_a_new_version_replaces_the_old_one(town: Town, cache: MapCache) -> None:
    cache.refresh()
    town.version = "v2"
    del town.features[0]
    snapshot = cache.refresh()
    assert snapshot.hd_map.identity.version == "v2"
    assert object_ids(cache.load().hd_map) == WHOLE[1:]


def test_a_version_that_comes_out_between_two_pages_is_not_mixed_with_the_old_one(
    fake, town: Town, cache: MapCache
) -> None:
    def answer(query: dict[str, str], headers: dict[str, str]):
        if len(town.queries) == 1:
            town.version = "v2"
            town.features[6] = feature(99)
        return town(query, headers)

    fake.pages = answer
    snapshot = cache.refresh()
    assert snapshot.hd_map.identity.version == "v2"
    assert (False, 99) in object_ids(snapshot.hd_map)
    assert len(snapshot.hd_map) == len(WHOLE)


def test_a_map_that_never_stands_still_is_told(fake, town: Town, cache: MapCache) -> None:
    def answer(query: dict[str, str], headers: dict[str, str]):
        town.version += "+"
        return town(query, headers)

    fake.pages = answer
    with pytest.raises(MapUnavailableError, match="changes faster"):
        cache.refresh()
    assert not cache.path.exists()


def test_only_the_part_asked_for_is_fetched_and_kept_apart(town: Town, server: Server, tmp_path: Path) -> None:
    path = tmp_path / "map.geojson"
    MapCache(path, server, "town", bbox=(2.0, 48.0, 2.5, 49.0)).refresh()
    assert town.queries[0]["bbox"] == "2.0000000,48.0000000,2.5000000,49.0000000"
    with pytest.raises(MapUnavailableError):
        MapCache(path, server, "town").load()
    assert MapCache(path, server, "town", bbox=(2.0, 48.0, 2.5, 49.0)).load().hd_map


@pytest.mark.parametrize("status", [429, 500, 502, 503])
def test_the_copy_serves_while_the_server_does_not(fake, faults, town: Town, cache: MapCache, status: int) -> None:
    first = cache.refresh()
    fake.pages = lambda _query, _headers: faults.problem(status)
    snapshot = cache.refresh()
    assert not snapshot.fresh
    assert snapshot.fetched_at == first.fetched_at
    assert object_ids(snapshot.hd_map) == WHOLE


def test_the_copy_serves_offline(town: Town, cache: MapCache, fake, faults, tmp_path: Path) -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        with Server(f"http://127.0.0.1:{nobody.getsockname()[1]}", "key") as gone:
            offline = MapCache(tmp_path / "other.geojson", gone, "town")
            with pytest.raises(MapUnavailableError, match=r"no copy of the map .* cannot connect"):
                offline.refresh()
    cache.refresh()
    town.features.append(feature(50))
    fake.pages = lambda _query, _headers: faults.Answer(200, {"type": "FeatureCollection"}, cut=3)
    assert object_ids(cache.refresh().hd_map) == WHOLE, "an answer cut short is none"


@pytest.mark.parametrize(
    "nonsense",
    [
        b"<html>Welcome</html>",
        b"[]",
        b"[" * 200_000,
        b'{"features": 3, "map": {}}',
        b'{"features": [], "map": {}, "next": 7}',
    ],
)
def test_nonsense_from_a_hotspot_does_not_harm_the_copy(fake, faults, town: Town, cache, nonsense: bytes) -> None:
    cache.refresh()
    before = cache.path.read_bytes()
    fake.pages = lambda _query, _headers: faults.Answer(200, nonsense)
    assert not cache.refresh().fresh
    assert cache.path.read_bytes() == before


def nested(depth: int) -> list:
    value: list = []
    for _ in range(depth):
        value = [value]
    return value


BROKEN = [
    {"geometry": {"type": "Point", "coordinates": [2.1, 90.0001]}},
    {"geometry": None},
    {"id": "seven"},
    {"properties": {"class": "traffic_sign", "tile_id": -1, "watch": True, "value": "\ud800"}},
    {"properties": {"class": "traffic_sign", "tile_id": -1, "value": nested(400)}},
    {"properties": {"class": "traffic_sign", "tile_id": -1, "existence_confidence": float("nan")}},
]


@pytest.mark.parametrize("broken", BROKEN)
def test_a_map_with_a_broken_feature_does_not_take_the_place_of_the_copy(town: Town, cache, caplog, broken) -> None:
    good = town.features[2]
    cache.refresh()
    before = cache.path.read_bytes()
    town.features[2] = {**good, **broken, "properties": {**broken.get("properties", good["properties"]), "tile_id": 5}}
    town.features[2]["properties"].pop("watch", None)
    snapshot = cache.refresh()
    assert not snapshot.fresh
    assert object_ids(snapshot.hd_map) == WHOLE
    assert snapshot.stale_because.startswith("the server's map cannot be used: ")
    assert "serves on" in caplog.text
    assert cache.path.read_bytes() == before
    assert list(cache.path.parent.iterdir()) == [cache.path], "no half-written file stays behind"
    cache.path.unlink()
    with pytest.raises(MapUnavailableError, match="cannot be used"):
        cache.refresh()
    assert list(cache.path.parent.iterdir()) == []


@pytest.mark.parametrize("broken", [*BROKEN, {"id": 1}, {"properties": {"class": "traffic_sign", "watch": True}}])
def test_a_watch_feature_that_cannot_be_used_is_passed_over(town: Town, cache, caplog, broken) -> None:
    town.features += [{**feature(2, tile_id=-1), **broken}, feature(3, tile_id=-1)]
    snapshot = cache.refresh()
    assert snapshot.fresh
    assert object_ids(snapshot.hd_map) == [*WHOLE, (True, 3)]
    assert caplog.text.count("is passed over") == 1
    again = cache.refresh()
    assert again.fresh
    assert object_ids(again.hd_map) == [*WHOLE, (True, 3)]
    assert town.sent == [200] * 4 + [304] * 4, "what was passed over does not cost the pages' ETags"


def test_an_unknown_map_and_a_wrong_key_are_errors_even_with_a_copy(fake, faults, town: Town, cache, tmp_path) -> None:
    cache.refresh()
    with Server(fake.url, "wrong") as stranger, pytest.raises(AuthenticationError):
        MapCache(tmp_path / "map.geojson", stranger, "town").refresh()
    fake.pages = lambda _query, _headers: faults.problem(404, "No such map")
    with pytest.raises(AnswerError, match="404, No such map"):
        cache.refresh()


@pytest.mark.parametrize("status", [302, 400, 401, 403, 404, 407, 408, 451, 511])
def test_what_a_middleman_says_leaves_the_copy(fake, faults, town: Town, cache, status: int) -> None:
    for answer in faults.middleman(status):
        fake.pages = lambda _query, _headers, answer=answer: answer
        cache.path.unlink(missing_ok=True)
        with pytest.raises(MapUnavailableError, match=f"no copy of the map .* answered {status}"):
            cache.refresh()
        fake.pages = town
        cache.refresh()
        fake.pages = lambda _query, _headers, answer=answer: answer
        snapshot = cache.refresh()
        assert not snapshot.fresh
        assert object_ids(snapshot.hd_map) == WHOLE


def test_pages_that_go_in_circles_end(fake, faults, cache: MapCache) -> None:
    fake.pages = lambda _query, _headers: faults.Answer(
        200, {"features": [], "map": {"source": "town"}, "next": "?watch=true"}
    )
    with pytest.raises(MapUnavailableError, match="come to no end"):
        cache.refresh()


def test_the_key_stays_with_its_server(town: Town, cache: MapCache) -> None:
    town.prefix = "http://192.0.2.1:9"  # a proxied server that does not know its own address, or a hostile one
    assert object_ids(cache.refresh().hd_map) == WHOLE


@pytest.mark.parametrize("damage", [lambda text: text[:-40], lambda text: text.replace("48.9]", "148.9]", 1)])
def test_a_damaged_copy_is_fetched_anew(fake, faults, town: Town, cache: MapCache, damage) -> None:
    cache.refresh()
    cache.path.write_text(damage(cache.path.read_text()))
    with pytest.raises(MapUnavailableError):
        cache.load()
    fake.pages = lambda _query, _headers: faults.problem(503)
    with pytest.raises(MapUnavailableError, match="no copy"):
        cache.refresh()
    fake.pages = town
    assert cache.refresh().fresh
    assert town.sent == [200] * 6, "the ETags of a copy that is none count for nothing"
    assert object_ids(cache.load().hd_map) == WHOLE
