"""HD maps: what is written is read, in pieces of any size, one feature at a time."""

import io
import itertools
import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.catalogue import FEATURE_CLASSES, SIGN_TYPES
from slamcu_core.formats import load_hd_map, read_hd_map, write_hd_map
from slamcu_core.formats.json_stream import MAX_ELEMENT
from slamcu_core.hd_map import MapFeature, MapIdentity

texts = st.text(st.characters(codec="utf-8", categories=("L", "N", "P")), min_size=1, max_size=20)


@st.composite
def features(draw: st.DrawFn) -> MapFeature:
    feature_class = draw(st.sampled_from(sorted(FEATURE_CLASSES)))
    tile_id = draw(st.integers(-(2**40), 2**40))
    return MapFeature(
        object_id=draw(st.integers(1, 2**63 - 1)),
        lon=draw(st.floats(-180.0, 180.0)),
        lat=draw(st.floats(-90.0, 90.0)),
        feature_class=feature_class,
        sign=draw(st.none() | (st.sampled_from(sorted(SIGN_TYPES)) if feature_class == "traffic_sign" else texts)),
        value=draw(st.none() | texts),
        altitude=draw(st.none() | st.floats(-400.0, 9000.0)),
        heading_deg=draw(st.none() | st.floats(-360.0, 360.0)),
        existence_confidence=draw(st.floats(1e-9, 1.0)),
        position_std_m=draw(st.floats(0.0, 10.0)),
        tile_id=tile_id,
        moved_from=draw(st.none() | st.integers(1, 2**63 - 1)) if tile_id < 0 else None,
    )


maps = st.lists(features(), max_size=5, unique_by=lambda feature: (feature.watched, feature.object_id))
identities = st.builds(MapIdentity, texts | st.just(""), texts | st.just(""))
IDENTITY = MapIdentity("highway", "2026.05.1")


@given(identity=st.builds(MapIdentity, texts, texts), written=maps, data=st.data())
def test_what_is_written_is_read_however_it_is_cut(
    identity: MapIdentity, written: list[MapFeature], data: st.DataObject
) -> None:
    text = "".join(write_hd_map(identity, written))
    raw = text.encode()
    cuts = sorted(data.draw(st.lists(st.integers(0, len(raw)), max_size=8)))
    pieces = [raw[a:b] for a, b in itertools.pairwise([0, *cuts, len(raw)])]  # also within a character

    reader = read_hd_map(pieces)

    assert list(reader) == written
    assert reader.identity == identity
    assert list(read_hd_map(text)) == written  # one character at a time
    json.loads(text)


def test_a_map_may_be_indented_or_not(feature_of: Callable[..., Any], text_of: Callable[..., str]) -> None:
    text = text_of(feature_of(1, tile_id=-3), feature_of(2, [2.0, 48.0, 120.5]), before={"map": {"source": "highway"}})
    expected = [
        MapFeature(1, 2.1, 48.9, sign="SPEED_LIMIT", value="80", tile_id=-3),
        MapFeature(2, 2.0, 48.0, sign="SPEED_LIMIT", value="80", altitude=120.5),
    ]

    assert list(read_hd_map([text])) == expected
    assert list(read_hd_map([json.dumps(json.loads(text))])) == expected
    assert list(read_hd_map(io.BytesIO(b"\xef\xbb\xbf" + text.encode()))) == expected
    assert expected[0].watched


def test_the_identity_may_stand_after_the_features(feature_of: Callable[..., Any], text_of: Callable[..., str]) -> None:
    about = {"source": "highway", "version": "2026.05.1", "licence": "none"}
    reader = read_hd_map([text_of(feature_of(), after={"map": about, "remark": [1, {"a": []}]})])

    with pytest.raises(RuntimeError, match="iterate over the features first"):
        _ = reader.identity
    list(reader)

    assert reader.identity == IDENTITY


@pytest.mark.parametrize("name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:EPSG::4326", "EPSG:4326"])
def test_wgs84_may_be_stated_as_older_writers_do(name: str) -> None:
    crs = {"type": "name", "properties": {"name": name}}

    assert list(read_hd_map([json.dumps({"type": "FeatureCollection", "crs": crs, "features": []})])) == []


def test_a_map_without_features_or_identity_is_a_map(text_of: Callable[..., str]) -> None:
    reader = read_hd_map([text_of()])

    assert list(reader) == []
    assert reader.identity == MapIdentity()


def test_a_whole_map_can_be_loaded(feature_of: Callable[..., Any], text_of: Callable[..., str]) -> None:
    hd_map = load_hd_map([text_of(feature_of(1), feature_of(1, tile_id=-1), after={"map": {"source": "highway"}})])

    assert len(hd_map) == 2
    assert hd_map.identity == MapIdentity("highway", "")


def test_features_are_read_as_their_text_arrives(feature_of: Callable[..., Any]) -> None:
    taken = 0

    def endless() -> Iterator[str]:
        nonlocal taken
        yield '{"type": "FeatureCollection", "features": ['
        for number in itertools.count(1):
            taken += 1
            yield json.dumps(feature_of(number)) + ","

    stream = iter(read_hd_map(endless()))

    assert [feature.object_id for feature in itertools.islice(stream, 1000)] == list(range(1, 1001))
    assert taken < 1100


def test_the_text_of_a_large_element_is_not_scanned_again_and_again(feature_of: Callable[..., Any]) -> None:
    big = json.dumps(feature_of(1, remark="x" * (MAX_ELEMENT // 2)))
    text = '{"type": "FeatureCollection", "features": [' + big + "]}"
    asked = 0

    def crumbs() -> Iterator[str]:
        nonlocal asked
        for at in range(0, len(text), 64):
            asked += 1
            yield text[at : at + 64]

    assert len(list(read_hd_map(crumbs()))) == 1
    assert asked == -(-len(text) // 64)


def test_sign_names_are_of_signs_only(feature_of: Callable[..., Any], text_of: Callable[..., str]) -> None:
    pole = feature_of(1, **{"class": "pole", "sign": "anything", "value": None})
    unknown = feature_of(2, sign="UNKNOWN_TYPE")

    read = list(read_hd_map([text_of(pole, unknown)]))

    assert (read[0].sign, read[0].value, read[1].sign) == ("anything", None, None)


def test_only_what_has_moved_makes_a_map_feature_disputed(
    feature_of: Callable[..., dict[str, Any]], text_of: Callable[..., str]
) -> None:
    text = text_of(
        feature_of(1), feature_of(2), feature_of(3),
        feature_of(1, tile_id=-3, kind="moved", replaces=2), feature_of(2, tile_id=-3, kind="modified", replaces=3),
    )  # fmt: skip
    hd_map = load_hd_map([text])
    mapped = [feature for feature in hd_map if not feature.watched]
    assert [hd_map.is_disputed(feature) for feature in mapped] == [False, True, False]
    assert [hd_map.prior(feature) for feature in hd_map] == [0.95, 0.0, 0.95, 0.0, 0.0]
