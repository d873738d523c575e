"""HD maps that are wrong: the feature, the line, the field and what was expected are named."""

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slamcu_core.errors import FormatError
from slamcu_core.formats import read_hd_map
from slamcu_core.formats.json_stream import MAX_ELEMENT

Json = dict[str, Any]
Make = Callable[..., Json]


def refusal(text: str | bytes) -> FormatError:
    with pytest.raises(FormatError) as caught:
        list(read_hd_map([text], source="map.geojson"))
    assert caught.value.source == "map.geojson"
    return caught.value


@pytest.mark.parametrize(
    ("feature", "field", "expected"),
    [
        ({"feature_id": 0}, "features[1].id", "an integer from 1, not 0"),
        ({"feature_id": "17"}, "features[1].id", "an integer from 1, not '17'"),
        ({"feature_id": 17.0}, "features[1].id", "an integer from 1, not 17"),
        ({"feature_id": True}, "features[1].id", "not a boolean"),
        ({"feature_id": None}, "features[1].id", "not null"),
        ({"feature_id": 2**63}, "features[1].id", "not an integer beyond 64 bits"),
        ({"coordinates": [181, 0]}, "features[1].geometry.coordinates", "feature 17: longitude 181, latitude 0"),
        ({"coordinates": [0, -90.1]}, "features[1].geometry.coordinates", "expected [-180, 180] and [-90, 90]"),
        ({"coordinates": [1]}, "features[1].geometry.coordinates", "a list of 2 or 3 numbers"),
        ({"coordinates": [1, 2, 3, 4]}, "features[1].geometry.coordinates", "a list of 2 or 3 numbers"),
        ({"coordinates": [1, "2"]}, "features[1].geometry.coordinates.1", "a number, not '2'"),
        ({"coordinates": [[1, 2], [3, 4]]}, "features[1].geometry.coordinates.0", "a number, not a list"),
        ({"class": "trafic_sign"}, "features[1].properties.class", "feature 17: expected one of bar, barrel"),
        ({"class": None}, "features[1].properties.class", "not null"),
        ({"sign": "SPEED"}, "features[1].properties.sign", "a SENSORIS TrafficSign type name, not 'SPEED'"),
        ({"sign": 274}, "features[1].properties.sign", "a SENSORIS TrafficSign type name, not 274"),
        ({"value": 80}, "features[1].properties.value", "text"),
        ({"existence_confidence": 0}, "features[1].properties.existence_confidence", "above 0 up to 1, not 0"),
        ({"existence_confidence": 1.5}, "features[1].properties.existence_confidence", "up to 1, not 1.5"),
        ({"position_std_m": -0.1}, "features[1].properties.position_std_m", "from 0, not -0.1"),
        ({"heading_deg": 400}, "features[1].properties.heading_deg", "from -360 to 360"),
        ({"tile_id": 1.5}, "features[1].properties.tile_id", "an integer, not 1.5"),
    ],
)
def test_a_fault_in_a_feature_is_named(
    feature_of: Make, text_of: Callable[..., str], feature: Json, field: str, expected: str
) -> None:
    bad = feature_of(**feature)
    text = text_of(feature_of(1), bad)

    error = refusal(text)

    assert error.field == field
    assert expected in error.message
    assert error.line == [number for number, line in enumerate(text.splitlines(), start=1) if line == "  {"][1]


@pytest.mark.parametrize(
    ("change", "field", "expected"),
    [
        ({"type": "Point"}, "features[0].type", '"Feature"'),
        ({"geometry": None}, "features[0].geometry", "an object, not null"),
        (
            {"geometry": {"type": "LineString", "coordinates": []}},
            "features[0].geometry.type",
            "\"Point\", not 'LineString'",
        ),
        ({"properties": None}, "features[0].properties", "an object, not null"),
        ({"properties": {}}, "features[0].properties.class", "but it is missing"),
    ],
)
def test_what_is_no_point_feature_is_named(
    feature_of: Make, text_of: Callable[..., str], change: Json, field: str, expected: str
) -> None:
    error = refusal(text_of(feature_of() | change))

    assert error.field == field
    assert expected in error.message


def test_two_equal_ids_are_refused_but_watch_features_have_their_own(
    feature_of: Make, text_of: Callable[..., str]
) -> None:
    assert len(list(read_hd_map([text_of(feature_of(5), feature_of(5, tile_id=-1))]))) == 2

    error = refusal(text_of(feature_of(5), feature_of(6), feature_of(5)))

    assert error.field == "features[2].id"
    assert error.message == "feature 5: an earlier feature has the same id"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "not a JSON object"),
        ("[]", "not a JSON object"),
        ("{", "expected the name of a member"),
        ("{}", "a list of features, but it is missing"),
        ('{"features": []}', 'expected "FeatureCollection", but it is missing'),
        ('{"type": "Feature", "features": []}', "not 'Feature'"),
        ('{"type": "FeatureCollection", "features": {}}', 'expected a list under "features"'),
        ('{"type": "FeatureCollection", "features": [], "features": []}', "expected one list, there are two"),
        ('{"type": "FeatureCollection", "type": "FeatureCollection"}', "stands twice"),
        ('{"type": "FeatureCollection", "features": [', "not valid JSON"),
        ('{"type": "FeatureCollection", "features": [{}', 'expected "Feature"'),
        ('{"type": "FeatureCollection", "features": []', 'expected "," or "}", but the file ends'),
        ('{"type": "FeatureCollection", "features": []} {}', "expected nothing after the object"),
        ('{"type": "FeatureCollection", "features": [], }', "expected the name of a member"),
        ('{"type": "FeatureCollection" "features": []}', 'expected "," or "}"'),
        ('{"type" "FeatureCollection"}', 'expected ":" after "type"'),
        ('{"type": "FeatureCollection", "features": [NaN]}', "NaN is not JSON"),
        ('{"type": "FeatureCollection", "features": [' + "[" * 100_000, "not valid JSON"),
        ('{"type": "FeatureCollection", "crs": {"name": "EPSG:25832"}, "features": []}', "expected WGS84"),
        ('{"type": "FeatureCollection", "map": 3, "features": []}', "expected an object, not 3"),
        ('{"type": "FeatureCollection", "map": {"version": 3}, "features": []}', "expected printable text"),
        (b'{"type": "FeatureCollection", "features": ["\xff"]}', "not UTF-8"),
        (b'{"type": "FeatureCollection", "features": [\xc3', "not UTF-8"),
    ],
)
def test_a_file_that_is_no_collection_is_refused(text: str | bytes, expected: str) -> None:
    assert expected in refusal(text).message


def test_broken_json_is_found_where_it_is_broken(feature_of: Make, text_of: Callable[..., str]) -> None:
    lines = text_of(*(feature_of(number) for number in range(1, 2000))).splitlines(keepends=True)
    broken = next(number for number, line in enumerate(lines) if '"id": 1500' in line)
    lines[broken] = lines[broken].replace(":", "=")

    with pytest.raises(FormatError, match="not valid JSON") as caught:
        list(read_hd_map(lines))

    assert caught.value.line == broken + 1


def test_a_huge_element_is_refused_before_it_fills_the_memory() -> None:
    taken = 0

    def endless() -> Iterator[str]:
        nonlocal taken
        yield '{"type": "FeatureCollection", "features": [{"remark": "'
        while True:
            taken += 1
            yield "x" * 4096

    with pytest.raises(FormatError, match=f"more than {MAX_ELEMENT} characters"):
        list(read_hd_map(endless()))
    assert taken * 4096 < 5 * MAX_ELEMENT


scalars = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=5)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_stands_in_a_map_nothing_but_format_errors_come_out(
    feature_of: Make, text_of: Callable[..., str], data: st.DataObject
) -> None:
    text = text_of(feature_of(1), feature_of(2), after={"map": {"source": "highway", "version": "1"}})
    at = data.draw(st.integers(0, len(text)))
    spoiled = (
        text[:at] + data.draw(scalars.map(json.dumps) | st.text(max_size=3)) + text[at + data.draw(st.integers(0, 9)) :]
    )
    reader = read_hd_map([spoiled])
    try:
        read = list(reader)
    except FormatError as error:
        read, line = [], error.line
    else:
        line = 1

    assert len(read) in (0, 1, 2)
    assert line is not None
    assert 1 <= line <= spoiled.count("\n") + 1
