"""What the cloud believes, read over HTTP as a map provider reads it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from slamcu_core.formats import ChangeState, ResultFeature
from slamcu_eval.fleet.provider import Provider

_PUBLISHED = frozenset({"confirmed", "accepted", "absorbed"})
_TO_SOMETHING = frozenset({"moved", "modified"})


def standing_changes(cloud: Provider, map_name: str) -> list[dict[str, Any]]:
    """Return each change of a map as the feed last told it, in the order in which that was said."""
    pages = cloud.pages("/v1/changes", {"map": map_name, "latest": "true", "limit": "1000"})
    return [entry["change"] for page in pages for entry in page["entries"]]


def fused_result(cloud: Provider, map_name: str) -> list[ResultFeature]:
    """Return what the cloud says of a map, as the features of a result file: what it has confirmed is a change."""
    changes = [change for change in standing_changes(cloud, map_name) if change["state"] in _PUBLISHED]
    about = {change["map_object_id"]: change for change in changes if change["kind"] != "new"}
    result = []
    for feature in cloud.features(map_name):
        evidence = cloud.get(f"/v1/features/{feature['properties']['feature_id']}")["standing"]
        result.append(_map_feature(feature, evidence, about.get(feature["id"])))
    return result + [_new_feature(change) for change in changes if change["kind"] == "new"]


def _map_feature(feature: dict[str, Any], evidence: dict[str, Any], change: dict[str, Any] | None) -> ResultFeature:
    properties = feature["properties"]
    variance = properties["position_std_m"] ** 2
    now = change if change is not None and change["kind"] in _TO_SOMETHING else None
    origin = None if now is None else now["from"]
    lon, lat = (now or feature)["geometry"]["coordinates"][:2]
    masses = evidence if now is None else now
    return ResultFeature(
        state=ChangeState(change["kind"]) if change else ChangeState.NORMAL,
        lon=lon,
        lat=lat,
        mass_exists=masses["mass_exists"],
        mass_not_exists=masses["mass_not_exists"],
        mass_unknown=masses["mass_unknown"],
        conflict=masses["conflict"],
        covariance_m2=_covariance(now["covariance_m2"] if now else (variance, 0.0, variance)),
        passes=evidence["passes"],
        vehicles=max(evidence["contributors_for"], evidence["contributors_against"]),
        map_object_id=feature["id"],
        feature_class=properties["class"],
        sign=now["sign"] if now else properties.get("sign"),
        value=now["value"] if now else properties.get("value"),
        from_lonlat=_lonlat(origin) if origin and change and change["kind"] == "moved" else None,
        map_sign=origin["sign"] if origin and change and change["kind"] == "modified" else None,
        map_value=origin["value"] if origin and change and change["kind"] == "modified" else None,
    )


def _lonlat(half: dict[str, Any]) -> tuple[float, float]:
    lon, lat = half["geometry"]["coordinates"][:2]
    return lon, lat


def _covariance(entries: Sequence[float]) -> tuple[float, float, float] | None:
    xx, xy, yy = entries
    return (xx, xy, yy) if xx > 0.0 else None


def _new_feature(change: dict[str, Any]) -> ResultFeature:
    lon, lat = _lonlat(change)
    return ResultFeature(
        state=ChangeState.NEW,
        lon=lon,
        lat=lat,
        mass_exists=change["mass_exists"],
        mass_not_exists=change["mass_not_exists"],
        mass_unknown=change["mass_unknown"],
        conflict=change["conflict"],
        covariance_m2=_covariance(change["covariance_m2"]),
        passes=change["passes"],
        vehicles=change["contributors_for"],
        feature_class=change["class"],
        sign=change["sign"],
        value=change["value"],
    )
