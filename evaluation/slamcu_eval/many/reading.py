"""What the cloud says of a road at one moment, read over HTTP as a map provider reads it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from slamcu_core.geometry import LocalFrame
from slamcu_eval.fleet import Cloud, standing_changes
from slamcu_eval.many.recording import claim_from
from slamcu_eval.score import UNCLASSIFIED, Claim

_PUBLISHED = frozenset({"confirmed", "accepted"})
_CANDIDATE_KINDS = frozenset({"new", "moved", "modified"})


@dataclass(frozen=True, slots=True)
class Statement:
    """What is said of a map feature, or of a candidate."""

    claim: Claim  # of a candidate that is no change: unclassified, without an object id
    belief: float  # e + u/2 that it exists; of a map feature as it is mapped
    decided_after: int | None  # informative contributions until the change stood; None: it does not stand
    looked: int  # vehicles that saw it or could have


@dataclass(frozen=True, slots=True)
class Reading:
    """All that is said when a number of vehicles have reported."""

    vehicles: int
    statements: tuple[Statement, ...]

    def to_document(self) -> dict[str, Any]:
        """Return it as JSON."""
        return {"vehicles": self.vehicles, "statements": [asdict(one) for one in self.statements]}

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Reading:
        """Read it again."""
        return cls(
            document["vehicles"],
            tuple(
                Statement(claim_from(one["claim"]), one["belief"], one["decided_after"], one["looked"])
                for one in document["statements"]
            ),
        )


def read_cloud(cloud: Cloud, map_name: str, frame: LocalFrame, vehicles: int, *, minimum: bool) -> Reading:
    """Ask a server for everything that it says of a map.

    Parameters
    ----------
    frame : the metric frame for places.
    vehicles : how many have reported.
    minimum : whether changes need what the policy asks for; otherwise the largest of the three masses decides.
    """
    statements: list[Statement] = []
    about: dict[int, dict[str, Any]] = {}
    for change in standing_changes(cloud, map_name):
        part_of_another = change["merged_into"] is not None or change["joined_into"] is not None
        if part_of_another or (change["state"] == "withdrawn" and change["kind"] != "new"):
            continue
        detail = cloud.get(f"/v1/changes/{change['id']}")
        claimed = change["state"] in _PUBLISHED if minimum else _largest(detail)
        if change["kind"] == "new":
            statements.append(_new(detail, frame, claimed=claimed))
        elif claimed:
            about[change["map_object_id"]] = detail
    for feature in cloud.features(map_name):
        evidence = cloud.get(f"/v1/features/{feature['properties']['feature_id']}")["standing"]
        statements.append(_mapped(feature, evidence, about.get(feature["id"]), frame))
    return Reading(vehicles, tuple(statements))


def _largest(change: dict[str, Any]) -> bool:
    """Whether the mass that speaks for a change is the largest of the three, on both ends if it has two."""
    if change["from"] is not None:
        return _prevails(change["to"], "mass_exists") and _prevails(change["from"], "mass_not_exists")
    return _prevails(change, "mass_exists" if change["kind"] == "new" else "mass_not_exists")


def _prevails(masses: dict[str, Any], name: str) -> bool:
    return bool(masses[name] >= max(masses["mass_exists"], masses["mass_not_exists"], masses["mass_unknown"]))


def _new(change: dict[str, Any], frame: LocalFrame, *, claimed: bool) -> Statement:
    now = change["evidence"]["evidence_now"]
    claim = Claim(
        state="new" if claimed else UNCLASSIFIED,
        place=_local(change["geometry"], frame),
        covariance=_spread(change),
        sign=change["sign"],
        value=change["value"],
        passes=change["passes"],
    )
    looked = {step["vehicle"] for step in change["evidence"]["course"]}
    return Statement(claim, _belief(now), _decided_after(change) if claimed else None, len(looked))


def _mapped(
    feature: dict[str, Any], evidence: dict[str, Any], change: dict[str, Any] | None, frame: LocalFrame
) -> Statement:
    properties = feature["properties"]
    elsewhere = change is not None and change["kind"] in _CANDIDATE_KINDS
    source = change if change is not None and elsewhere else None
    claim = Claim(
        state=change["kind"] if change else "normal",
        place=_local((source or feature)["geometry"], frame),
        covariance=_spread(source) if source else None,
        object_id=feature["id"],
        sign=source["sign"] if source else properties.get("sign"),
        value=source["value"] if source else properties.get("value"),
        passes=evidence["passes"],
    )
    return Statement(claim, _belief(evidence), _decided_after(change) if change else None, evidence["passes"])


def _decided_after(change: dict[str, Any]) -> int | None:
    for number, step in enumerate(change["evidence"]["course"], start=1):
        if step["standing"]:
            return number
    return None


def _belief(masses: dict[str, Any]) -> float:
    return float(masses["mass_exists"] + 0.5 * masses["mass_unknown"])


def _spread(change: dict[str, Any]) -> tuple[float, float, float]:
    xx, xy, yy = change["covariance_m2"]
    return float(xx), float(xy), float(yy)


def _local(geometry: dict[str, Any], frame: LocalFrame) -> tuple[float, float]:
    x, y = frame.to_local(*geometry["coordinates"][:2]).tolist()
    return float(x), float(y)
