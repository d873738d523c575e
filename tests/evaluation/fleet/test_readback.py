"""The cloud's changes of every kind, as the features of a result file."""

from __future__ import annotations

from typing import Any, cast

import pytest

from slamcu_core.formats import ChangeState
from slamcu_eval.fleet import Cloud, fused_result

_EVIDENCE = {"mass_exists": 0.1, "mass_not_exists": 0.8, "mass_unknown": 0.1, "conflict": 0.2}
_COUNTS = {"passes": 4, "contributors_for": 1, "contributors_against": 3}


class _Answers:
    """What a server answers, without one."""

    def __init__(self, changes: list[dict[str, Any]]) -> None:
        self._changes = changes

    def pages(self, path: str, parameters: dict[str, str]) -> list[dict[str, Any]]:
        return [{"entries": [{"change": change} for change in self._changes]}]

    def features(self, name: str) -> list[dict[str, Any]]:
        properties = {"class": "traffic_sign", "sign": "SPEED_LIMIT", "value": "80", "position_std_m": 0.15}
        return [{"id": 7, "geometry": {"coordinates": [2.0, 48.0]}, "properties": {**properties, "feature_id": 70}}]

    def get(self, path: str) -> dict[str, Any]:
        assert path == "/v1/features/70"
        return {"standing": {**_EVIDENCE, **_COUNTS}}


def change(kind: str, state: str = "confirmed", **members: Any) -> dict[str, Any]:
    half = {"geometry": {"coordinates": [2.0, 48.0]}, "sign": "SPEED_LIMIT", "value": "80"}
    return {
        "kind": kind,
        "state": state,
        "map_object_id": 7,
        "geometry": {"coordinates": [2.1, 48.1]},
        "covariance_m2": [0.2, 0.0, 0.3],
        "class": "traffic_sign",
        "sign": "SPEED_LIMIT",
        "value": "60",
        "mass_exists": 0.9,
        "mass_not_exists": 0.0,
        "mass_unknown": 0.1,
        "conflict": 0.0,
        **_COUNTS,
        "from": half if kind in {"moved", "modified"} else None,
        **members,
    }


def result(*changes: dict[str, Any]) -> list[Any]:
    return fused_result(cast("Cloud", _Answers(list(changes))), "town")


def test_a_moved_sign_stands_where_it_is_and_tells_where_it_was() -> None:
    [moved] = result(change("moved"))
    assert (moved.state, moved.lon, moved.lat, moved.from_lonlat) == (ChangeState.MOVED, 2.1, 48.1, (2.0, 48.0))
    assert (moved.map_object_id, moved.mass_exists, moved.covariance_m2) == (7, 0.9, (0.2, 0.0, 0.3))


def test_a_modified_sign_says_both() -> None:
    [modified] = result(change("modified"))
    assert (modified.state, modified.value, modified.map_sign, modified.map_value) == (
        ChangeState.MODIFIED,
        "60",
        "SPEED_LIMIT",
        "80",
    )
    assert modified.from_lonlat is None


@pytest.mark.parametrize(
    ("kind", "state"), [("moved", "candidate"), ("deleted", "withdrawn"), ("modified", "rejected")]
)
def test_what_is_not_confirmed_is_not_said(kind: str, state: str) -> None:
    [feature] = result(change(kind, state))
    assert (feature.state, feature.lon, feature.value) == (ChangeState.NORMAL, 2.0, "80")


def test_deleted_and_new_ones_are_told_apart() -> None:
    deleted, new = result(change("deleted"), change("new", map_object_id=None))
    assert (deleted.state, deleted.mass_not_exists, deleted.lon) == (ChangeState.DELETED, 0.8, 2.0)
    assert (new.state, new.lon, new.covariance_m2) == (ChangeState.NEW, 2.1, (0.2, 0.0, 0.3))
