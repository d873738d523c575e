"""Lanelet2 maps: which signs and lights are read, where they stand, and what is said of a map that cannot be read."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from slamcu_core.catalogue import SIGN_TYPES
from slamcu_core.errors import FormatError
from slamcu_core.formats import read_lanelet2
from slamcu_core.formats.national_signs import read_national_sign
from slamcu_core.hd_map import MapFeature, MapIdentity

NODES = """
  <node id="1" visible="true" lat="49.0" lon="8.4"/>
  <node id="2" lat="49.00002" lon="8.40002"><tag k="ele" v="115"/></node>
  <node id="3" lat="49.00001" lon="8.40001"/>
"""


def osm(*elements: str) -> str:
    return f"<?xml version='1.0' encoding='UTF-8'?>\n<osm version='0.6'>{NODES}{''.join(elements)}\n</osm>\n"


def way(number: object, refs: tuple[int, ...], attributes: str = "", **tags: str) -> str:
    inner = "".join(f"<nd ref='{ref}'/>" for ref in refs)
    inner += "".join(f"<tag k='{key}' v='{value}'/>" for key, value in tags.items())
    return f"\n  <way id='{number}' {attributes}>{inner}</way>"


def read(text: str) -> list[MapFeature]:
    return list(read_lanelet2([text.encode()], source="town.osm"))


def test_signs_and_lights_are_read_and_nothing_else() -> None:
    text = osm(
        way(10, (1, 2), type="traffic_sign", subtype="de274-80"),
        way(11, (1, 3, 2), type="traffic_light", subtype="red_yellow_green"),
        way(12, (1, 2), type="line_thin", subtype="dashed"),
        way(13, (1, 99), type="curbstone"),  # of an extract: its other node is elsewhere
        "<relation id='20'><member type='way' ref='10' role='refers'/><tag k='type' v='traffic_sign'/></relation>",
    )
    reader = read_lanelet2([text])
    sign, light = reader
    assert (sign.object_id, sign.feature_class, sign.sign, sign.value) == (10, "traffic_sign", "SPEED_LIMIT", "80")
    assert (light.object_id, light.feature_class, light.sign, light.value) == (11, "traffic_light", None, None)
    assert (sign.lon, sign.lat) == pytest.approx((8.40001, 49.00001), abs=1e-9)
    assert sign.altitude is None  # of no stated datum
    assert reader.identity == MapIdentity()
    assert not reader.unknown_signs


def test_pieces_of_any_size_are_the_same_map() -> None:
    text = osm(*(way(10 + n, (1, 2), type="traffic_sign", subtype="de205") for n in range(5)))

    def bytewise() -> Iterator[bytes]:
        yield from (bytes([byte]) for byte in text.encode())

    assert list(read_lanelet2(bytewise())) == read(text)


def test_a_ring_counts_its_first_corner_once() -> None:
    (light,) = read(osm(way(5, (1, 3, 2, 1), type="traffic_light")))
    assert light.lon == pytest.approx(8.40001, abs=1e-9)


def test_a_sign_may_stand_on_the_antimeridian() -> None:
    nodes = "<node id='7' lat='0' lon='179.999999'/><node id='8' lat='0' lon='-179.999997'/>"
    (sign,) = read(osm(nodes, way(5, (7, 8), type="traffic_sign")))
    assert sign.lon == pytest.approx(-179.999999, abs=1e-9)


def test_a_sign_of_an_unknown_number_stays_without_type() -> None:
    text = osm(
        way(1, (1, 2), type="traffic_sign", subtype="de9999"),
        way(2, (1, 2), type="traffic_sign", subtype="xx205"),
        way(3, (1, 2), type="traffic_sign"),
    )
    reader = read_lanelet2([text])
    assert [(sign.sign, sign.value) for sign in reader] == [(None, None)] * 3
    assert reader.unknown_signs == {"de9999": 1, "xx205": 1, "": 1}


@pytest.mark.parametrize("attributes", ["visible='false'", "action='delete'"])
def test_what_is_deleted_is_left_out(attributes: str) -> None:
    gone = f"<node id='4' {attributes}/>"  # a deleted node has no place
    assert read(osm(gone, way(1, (1, 2), attributes, type="traffic_sign"))) == []


SIGN = {"type": "traffic_sign", "subtype": "de205"}
BAD = {
    "no xml": ("type: map", r"town\.osm, line 1: expected OSM XML"),
    "another document": ("<html></html>", r"line 1: expected an OSM document"),
    "half a document": (osm()[:-10], r"town\.osm, line \d+: expected OSM XML"),
    "nothing": ("", r"expected OSM XML"),
    "a document type": ("<!DOCTYPE osm [<!ENTITY a 'aaaa'>]><osm/>", r"line 1: a document type is not accepted"),
    "an id that is no number": (osm(way("x", (1, 2), **SIGN)), r"line 7, field way\.id: expected an integer"),
    "an id that is not settled": (osm(way(-7, (1, 2), **SIGN)), r"line 7, field way -7: expected a positive id"),
    "two equal ids": (osm(way(5, (1, 2), **SIGN), way(5, (1, 3), **SIGN)), r"line 8, field way 5: two ways"),
    "a missing node": (osm(way(5, (1, 99), **SIGN)), r"line 7, field way 5: its node 99"),
    "no nodes": (osm(way(5, (), **SIGN)), r"field way 5: expected nodes"),
    "local coordinates": (osm("<node id='9' lat='' lon=''/>"), r"node 9: expected lat and lon"),
    "a latitude out of range": (osm("<node id='9' lat='91' lon='0'/>"), r"node 9\.lat: expected degrees"),
    "no number": (osm("<node id='9' lat='0' lon='nan'/>"), r"node 9\.lon: expected degrees"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_read_is_named(name: str) -> None:
    text, named = BAD[name]
    with pytest.raises(FormatError, match=named):
        read(text)


@pytest.mark.parametrize(
    ("code", "sign", "value"),
    [
        ("de205", "YIELD", None),
        ("de206", "STOP_SIGN", None),
        ("DE:274-50", "SPEED_LIMIT", "50"),
        ("de274", "SPEED_LIMIT", None),  # which speed it does not say
        ("de274_1", "SPEED_LIMIT_ZONE", "30"),
        ("de274.1-20", "SPEED_LIMIT_ZONE", "20"),
        ("de278-80", "SPEED_LIMIT_END", "80"),
        ("de103-10", "SHARP_CURVE_LEFT", None),
        ("de103-99", "SHARP_CURVE", None),  # a variant that is not known is still the sign
        ("de102", "CROSSING_WITH_PRIORITY_TO_THE_RIGHT", None),
        ("fr205", None, None),
        ("205", None, None),
    ],
)
def test_national_numbers(code: str, sign: str | None, value: str | None) -> None:
    assert read_national_sign(code) == (sign, value)


def test_every_number_names_a_sign_type() -> None:
    numbers = [f"{n}{part}" for n in range(1000) for part in ("", ".1", ".2", "-10", "-20", "-30")]
    signs = {sign for sign in (read_national_sign(f"de{number}").sign for number in numbers) if sign is not None}
    assert len(signs) > 90
    assert signs <= SIGN_TYPES
