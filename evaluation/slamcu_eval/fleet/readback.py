"""What the cloud believes, read over HTTP as a map provider reads it."""

from __future__ import annotations

from typing import Any

from slamcu_core.formats import ChangeState, ResultFeature
from slamcu_eval.fleet.cloud import Cloud

_PUBLISHED = frozenset({"confirmed", "accepted"})


def standing_changes(cloud: Cloud, map_name: str) -> list[dict[str, Any]]:
    """Return each change of a map as the feed last told it, in the order in which that was said."""
    pages = cloud.pages("/v1/changes", {"map": map_name, "latest": "true", "limit": "1000"})
    return [entry["change"] for page in pages for entry in page["entries"]]


def fused_result(cloud: Cloud, map_name: str) -> list[ResultFeature]:
    """Return what the cloud says of a map, as the features of a result file: what it has confirmed is a change."""
    changes = [change for change in standing_changes(cloud, map_name) if change["state"] in _PUBLISHED]
    about = {change["map_object_id"]: change for change in changes if change["kind"] != "new"}
    result = []
    for feature in cloud.features(map_name):
        evidence = cloud.get(f"/v1/features/{feature['properties']['feature_id']}")["standing"]
        result.append(_map_feature(feature, evidence, about.get(feature["id"])))
    return result + [_new_feature(change) for change in changes if change["kind"] == "new"]


def _map_feature(feature: dict[str, Any], evidence: dict[str, Any], change: dict[str, Any] | None) -> ResultFeature:
    lon, lat = feature["geometry"]["coordinates"][:2]
    properties = feature["properties"]
    variance = properties["position_std_m"] ** 2
    return ResultFeature(
        state=ChangeState(change["kind"]) if change else ChangeState.NORMAL,
        lon=lon,
        lat=lat,
        mass_exists=evidence["mass_exists"],
        mass_not_exists=evidence["mass_not_exists"],
        mass_unknown=evidence["mass_unknown"],
        conflict=evidence["conflict"],
        covariance_m2=(variance, 0.0, variance) if variance > 0.0 else None,
        passes=evidence["passes"],
        vehicles=max(evidence["contributors_for"], evidence["contributors_against"]),
        map_object_id=feature["id"],
        feature_class=properties["class"],
        sign=properties.get("sign"),
        value=properties.get("value"),
    )


def _new_feature(change: dict[str, Any]) -> ResultFeature:
    lon, lat = change["geometry"]["coordinates"][:2]
    xx, xy, yy = change["covariance_m2"]
    return ResultFeature(
        state=ChangeState.NEW,
        lon=lon,
        lat=lat,
        mass_exists=change["mass_exists"],
        mass_not_exists=change["mass_not_exists"],
        mass_unknown=change["mass_unknown"],
        conflict=change["conflict"],
        covariance_m2=(xx, xy, yy),
        passes=change["passes"],
        vehicles=change["contributors_for"],
        feature_class=change["class"],
        sign=change["sign"],
        value=change["value"],
    )
