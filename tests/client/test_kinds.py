"""What a car's own result says of a sign that changed: the two halves are one change."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import pytest

from slamcu_client.kinds import with_kinds
from slamcu_client.results import result_features
from slamcu_client.summary import summary_lines
from slamcu_core.evidence import Masses
from slamcu_core.filter import FeatureEstimate
from slamcu_core.formats import read_results, write_results
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import HDMap, MapFeature, MapIdentity

FRAME = LocalFrame(2.1, 48.9)


def estimate(
    state: str, x: float, sign: str | None, value: str | None = None, object_id: int | None = None
) -> FeatureEstimate:
    lon, lat = (float(part) for part in FRAME.to_geographic([x, 0.0]))
    gone = state == "deleted"
    return FeatureEstimate(
        feature=None if object_id is None else MapFeature(object_id, lon, lat, sign=sign, value=value),
        state=state,
        masses=Masses(0.05, 0.9, 0.05) if gone else Masses(0.9, 0.05, 0.05),
        conflict=0.1,
        lon=lon,
        lat=lat,
        covariance_m2=(0.02, 0.0, 0.02) if object_id else (0.6, 0.1, 0.5),
        passes=1,
        feature_class="traffic_sign",
        sign=sign,
        value=value,
    )


def told(estimates: Sequence[FeatureEstimate]) -> list[tuple[str, int | None, str | None]]:
    return [(one.state, one.feature.object_id if one.feature else None, one.value) for one in with_kinds(estimates)]


def test_another_value_in_the_place_of_a_deleted_sign_is_one_modified_sign() -> None:
    there = estimate("new", 1.2, "SPEED_LIMIT", "80")
    result = with_kinds([estimate("deleted", 0.0, "SPEED_LIMIT", "130", 7), there])
    (one,) = list(read_results(write_results(result_features(result))))
    assert (one.state.value, one.map_object_id) == ("modified", 7)
    assert (one.sign, one.value, one.map_sign, one.map_value) == ("SPEED_LIMIT", "80", "SPEED_LIMIT", "130")
    assert (one.lon, one.lat) == pytest.approx((there.lon, there.lat))
    assert one.mass_exists == pytest.approx(0.9)


def test_the_same_sign_near_a_deleted_one_has_moved_there() -> None:
    gone = estimate("deleted", 0.0, "SPEED_LIMIT", "130", 7)
    (one,) = result_features(with_kinds([gone, estimate("new", 18.0, "SPEED_LIMIT", "130")]))
    assert (one.state.value, one.map_object_id) == ("moved", 7)
    assert one.from_lonlat == (gone.lon, gone.lat)
    document = json.loads("".join(write_results([one])))
    assert document["features"][0]["properties"]["from"] == [gone.lon, gone.lat]


def test_a_change_stays_one_when_the_cloud_has_put_its_other_half_on_watch() -> None:
    gone, there = estimate("deleted", 0.0, "SPEED_LIMIT", "130", 7), estimate("new", 18.0, "SPEED_LIMIT", "130")
    watched = replace(there, feature=MapFeature(3, there.lon, there.lat, sign="SPEED_LIMIT", value="130", tile_id=-5))
    (one,) = result_features(with_kinds([gone, watched]))
    assert (one.state.value, one.map_object_id) == ("moved", 7)
    assert (one.lon, one.lat) == (there.lon, there.lat)
    unseen = replace(watched, state="unclassified")
    assert with_kinds([gone, unseen]) == [gone, unseen]
    hd_map = HDMap([gone.feature, watched.feature], MapIdentity("town", "1"))
    lines = [" ".join(line.split()) for line in summary_lines(hd_map, with_kinds([gone, watched]))]
    assert "moved 1" in lines
    assert lines[-4:] == ["on watch for the cloud: 1 candidates", "there 1", "not there 0", "undecided 0"]


@pytest.mark.parametrize(
    "halves",
    [
        pytest.param([estimate("normal", 0.0, "STOP", None, 7), estimate("new", 1.0, "STOP")], id="nothing is gone"),
        pytest.param([estimate("deleted", 0.0, "STOP", None, 7), estimate("new", 90.0, "STOP")], id="too far"),
        pytest.param([estimate("deleted", 0.0, "STOP", None, 7), estimate("new", 18.0, "YIELD")], id="another sign"),
        pytest.param([estimate("deleted", 0.0, None, None, 7), estimate("new", 1.0, None)], id="no sign is known"),
        pytest.param([estimate("deleted", 0.0, "STOP", None, 7), estimate("unclassified", 1.0, "YIELD")], id="no find"),
    ],
)
def test_what_is_not_one_change_stays_two(halves: list[FeatureEstimate]) -> None:
    assert with_kinds(halves) == halves


def test_a_find_is_half_of_one_change_at_most() -> None:
    gone = [estimate("deleted", x, "SPEED_LIMIT", "130", i + 1) for i, x in enumerate((0.0, 3.0))]
    result = told([*gone, estimate("new", 2.5, "SPEED_LIMIT", "80")])
    assert result == [("deleted", 1, "130"), ("modified", 2, "80")]
