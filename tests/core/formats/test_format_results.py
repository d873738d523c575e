"""Truth and results: what is written is read, and what makes no sense is refused."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.catalogue import SIGN_TYPES
from slamcu_core.errors import FormatError
from slamcu_core.formats import (
    ChangeState,
    ResultFeature,
    TruthFeature,
    read_results,
    read_truth,
    write_results,
    write_truth,
)

Json = dict[str, Any]

longitudes, latitudes = st.floats(-180.0, 180.0), st.floats(-90.0, 90.0)
texts = st.none() | st.text(st.characters(codec="utf-8", categories=("L", "N", "P")), min_size=1, max_size=20)
signs = st.none() | st.sampled_from(sorted(SIGN_TYPES))
ids = st.none() | st.integers(1, 2**60)
common: dict[str, st.SearchStrategy[Any]] = {
    "lon": longitudes,
    "lat": latitudes,
    "sign": signs,
    "value": texts,
    "map_sign": signs,
    "map_value": texts,
    "id": ids,
}


@st.composite
def truths(draw: st.DrawFn) -> TruthFeature:
    state = draw(st.sampled_from([state for state in ChangeState if state is not ChangeState.UNCLASSIFIED]))
    return TruthFeature(
        truth=state,
        map_object_id=None if state is ChangeState.NEW else draw(st.integers(1, 2**60)),
        from_lonlat=(draw(longitudes), draw(latitudes)) if state is ChangeState.MOVED else None,
        **{name: draw(strategy) for name, strategy in common.items()},
    )


@st.composite
def results(draw: st.DrawFn) -> ResultFeature:
    e = draw(st.floats(0.0, 1.0))
    n = draw(st.floats(0.0, 1.0 - e))
    variance = st.floats(1e-3, 1e3)
    return ResultFeature(
        state=draw(st.sampled_from(ChangeState)),
        mass_exists=e,
        mass_not_exists=n,
        mass_unknown=max(0.0, 1.0 - e - n),
        conflict=draw(st.floats(0.0, 1.0)),
        covariance_m2=draw(st.none() | st.tuples(variance, st.just(0.0), variance)),
        passes=draw(st.integers(0, 10**6)),
        vehicles=draw(st.integers(0, 10**6)),
        map_object_id=draw(ids),
        feature_class=draw(st.sampled_from(["traffic_sign"])),
        from_lonlat=draw(st.none() | st.tuples(longitudes, latitudes)),
        **{name: draw(strategy) for name, strategy in common.items()},
    )


@given(written=st.lists(truths(), max_size=5))
def test_truth_comes_back_as_it_was(written: list[TruthFeature]) -> None:
    assert list(read_truth(write_truth(written))) == written


@given(written=st.lists(results(), max_size=5))
def test_results_come_back_as_they_were(written: list[ResultFeature]) -> None:
    assert list(read_results(write_results(written))) == written


def test_results_are_plain_geojson_with_the_documented_names() -> None:
    result = ResultFeature(
        state=ChangeState.MOVED,
        lon=2.1,
        lat=48.9,
        mass_exists=0.8,
        mass_not_exists=0.1,
        mass_unknown=0.1,
        conflict=0.2,
        covariance_m2=(0.5, 0.1, 0.4),
        passes=7,
        vehicles=3,
        map_object_id=17,
        sign="STOP_SIGN",
        from_lonlat=(2.0, 48.8),
    )

    document = json.loads("".join(write_results([result])))

    assert document["type"] == "FeatureCollection"
    (feature,) = document["features"]
    assert feature["geometry"] == {"type": "Point", "coordinates": [2.1, 48.9]}
    assert feature["properties"] == {
        "state": "moved",
        "mass_exists": 0.8,
        "mass_not_exists": 0.1,
        "mass_unknown": 0.1,
        "conflict": 0.2,
        "covariance_m2": [0.5, 0.1, 0.4],
        "passes": 7,
        "vehicles": 3,
        "class": "traffic_sign",
        "sign": "STOP_SIGN",
        "map_object_id": 17,
        "from": [2.0, 48.8],
    }


def test_what_has_no_place_for_a_value_leaves_it_out() -> None:
    (feature,) = json.loads("".join(write_truth([TruthFeature(truth=ChangeState.NEW, lon=1.0, lat=2.0)])))["features"]

    assert feature["properties"] == {"truth": "new", "class": "traffic_sign"}
    assert "id" not in feature


MASSES = {"state": "normal", "mass_exists": 0.5, "mass_not_exists": 0.25, "mass_unknown": 0.25}


@pytest.mark.parametrize(
    ("read", "fault"),
    [
        (read_truth, ({"truth": "unclassified"}, "truth", "one of deleted, modified, moved, new, normal")),
        (read_truth, ({"truth": "gone"}, "truth", "not 'gone'")),
        (read_truth, ({}, "truth", "but it is missing")),
        (read_truth, ({"truth": "deleted"}, "map_object_id", "an integer from 1")),
        (read_truth, ({"truth": "moved", "map_object_id": 1}, "from", "a list of 2 numbers")),
        (read_truth, ({"truth": "moved", "map_object_id": 1, "from": [0, 91]}, "from", "[longitude, latitude]")),
        (read_truth, ({"truth": "moved", "map_object_id": 1, "from": [-181, 0]}, "from", "[longitude, latitude]")),
        (read_truth, ({"truth": "modified", "map_object_id": 1, "map_sign": "X"}, "map_sign", "TrafficSign type")),
        (read_results, (MASSES | {"mass_exists": 0.6}, "mass_exists", "the three masses sum to 1.1, expected 1")),
        (read_results, (MASSES | {"mass_unknown": -0.1}, "mass_unknown", "from 0 to 1")),
        (read_results, (MASSES | {"state": "old"}, "state", "unclassified")),
        (read_results, (MASSES | {"covariance_m2": [1, 2, 1]}, "covariance_m2", "positive definite")),
        (read_results, (MASSES | {"conflict": 2}, "conflict", "from 0 to 1")),
        (read_results, (MASSES | {"passes": -1}, "passes", "an integer from 0")),
        (read_results, (MASSES | {"map_object_id": 0}, "map_object_id", "an integer from 1")),
        (read_results, (MASSES | {"vehicles": 1.0}, "vehicles", "an integer from 0")),
    ],
)
def test_a_fault_is_named(
    feature_of: Callable[..., Json],
    text_of: Callable[..., str],
    read: Callable[..., object],
    fault: tuple[Json, str, str],
) -> None:
    properties, field, expected = fault
    with pytest.raises(FormatError) as caught:
        list(read([text_of(feature_of(**properties))], source="result.geojson"))  # type: ignore[call-overload]

    assert caught.value.field == f"features[0].properties.{field}"
    assert expected in caught.value.message
