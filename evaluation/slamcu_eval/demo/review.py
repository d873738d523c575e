"""The map provider's part: read the changes, look behind one, accept it, and see the map's next version."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from slamcu_core.errors import SlamcuError
from slamcu_eval.fleet import Cloud, standing_changes


@dataclass(frozen=True, slots=True)
class Acceptance:
    """A change that was accepted, and the map before and after."""

    change: dict[str, Any]  # as it was read before the review
    version_before: str
    version_after: str
    features_before: int
    features_after: int
    feature: dict[str, Any] | None  # the new feature as the map has it now


def accept_best(cloud: Cloud, map_name: str) -> Acceptance:
    """Accept the new sign that the cloud is surest of.

    Raises SlamcuError if no new sign is confirmed.
    """
    confirmed = [c for c in standing_changes(cloud, map_name) if c["kind"] == "new" and c["state"] == "confirmed"]
    if not confirmed:
        raise SlamcuError("no new sign is confirmed, so none can be accepted")
    best = max(confirmed, key=lambda change: (change["mass_exists"], change["contributors_for"], -change["id"]))
    before, known = cloud.map_summary(map_name), {feature["id"] for feature in cloud.features(map_name)}
    cloud.accept(best["id"])
    after, now = cloud.map_summary(map_name), cloud.features(map_name)
    added = [feature for feature in now if feature["id"] not in known]
    return Acceptance(
        change=best,
        version_before=before["version"],
        version_after=after["version"],
        features_before=len(known),
        features_after=len(now),
        feature=added[0] if added else None,
    )
