"""The same passes through the real client and the real server: what stands there must be what the fold says.

Signs in a row, far enough apart not to be confused; vehicles pass all of them, an hour after each other. Some stand and
are missed now and then, some are gone, and between them are new ones. What each vehicle saw goes through an outbox,
the wire, the server's log and its worker; then the masses of every feature and every change are compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcu_client import Outbox, Server, Uploader
from slamcu_core.aggregation import ClassPolicy, Contribution, PassEvidence, Policy, Side, Trusts, contributions, fold
from slamcu_core.evidence import masses_from_weights
from slamcu_core.formats import write_hd_map
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import MapFeature, MapIdentity
from slamcu_core.reports import DetectionStatus, MapReference, MeasuredPosition, PassReport, ReportMessage
from slamcu_core.sensoris import serialize_message
from slamcu_eval.fleet import Cloud, standing_changes
from slamcu_eval.law.passes import FULL_WEIGHT, PRIOR

_MAP = MapIdentity("law", "1")
_SPACING_M = 100.0
_FRAME = LocalFrame(2.1, 48.9)
_TIMEOUT_S = 120.0


@dataclass(frozen=True, slots=True)
class Story:
    """What vehicles, (V,), see of features, (V, N): the first `mapped` are in the map, the others are new."""

    seen: NDArray[np.bool_]
    mapped: int

    @classmethod
    def draw(cls, vehicles: int, features: int, seed: int) -> Story:
        """Draw a third each of signs that stand, signs that are gone and new ones, missed in a tenth of passes."""
        rng = np.random.default_rng(seed)
        gone = np.arange(features) % 3 == 1
        new = np.arange(features) % 3 == 2
        order = np.argsort(new, kind="stable")
        seen = rng.random((vehicles, features)) < np.where(gone, 0.05, 0.9)
        return cls(seen[:, order], int(features - new.sum()))


def confirm(policy: Policy, *, vehicles: int, features: int, seed: int) -> dict[str, Any]:
    """Report a story to a server and return how far it is from the fold."""
    story = Story.draw(vehicles, features, seed)
    begin = datetime.now(UTC).replace(minute=0, second=0, microsecond=0) - timedelta(hours=vehicles + 1)
    rules = policy.trusting(Trusts()).for_class("traffic_sign")  # as a server that knows nobody
    with Cloud(policy=policy) as cloud:
        path = cloud.scratch / "map.geojson"
        path.write_text("".join(write_hd_map(_MAP, [_sign(n) for n in range(story.mapped)])), encoding="utf-8")
        cloud.import_map(path)
        for vehicle, key in enumerate(cloud.create_keys("vehicle", vehicles)):
            _tell(cloud, key, _message(story, vehicle, begin))
        cloud.wait_until_fused(_TIMEOUT_S)
        changes = standing_changes(cloud, _MAP.source)
        details = [cloud.get(f"/v1/changes/{change['id']}") for change in changes]
    return _compare(story, begin, details, rules)


def _compare(story: Story, begin: datetime, details: list[dict[str, Any]], rules: ClassPolicy) -> dict[str, Any]:
    by_feature = {_number_of(detail, story): detail for detail in details if detail["kind"] in ("new", "deleted")}
    agree, worst = 0, 0.0
    for number in range(story.seen.shape[1]):
        mapped = number < story.mapped
        parts = _parts(story, number, begin, rules)
        side = Side.DELETED if mapped else Side.NEW
        state = fold(parts, prior_weight=PRIOR if mapped else 0.0, policy=rules, side=side)
        told = by_feature.get(number)
        agree += (told is not None and told["state"] == "confirmed") == state.standing
        if told is not None and told["evidence"]["course"]:
            last = told["evidence"]["course"][-1]
            expected = masses_from_weights(state.weight_for, state.weight_against)
            names = ("mass_exists", "mass_not_exists", "mass_unknown")
            worst = max(worst, *(abs(last[name] - float(m)) for name, m in zip(names, expected, strict=True)))
    return {
        "vehicles": story.seen.shape[0],
        "features": story.seen.shape[1],
        "passes": int(story.mapped * story.seen.shape[0] + story.seen[:, story.mapped :].sum()),
        "agree": agree,
        "largest_difference_of_masses": worst,
    }


def _parts(story: Story, number: int, begin: datetime, rules: ClassPolicy) -> list[Contribution]:
    passes = [
        PassEvidence(
            vehicle,
            _at(begin, vehicle, number).timestamp(),
            FULL_WEIGHT if seen else 0.0,
            0.0 if seen else FULL_WEIGHT,
        )
        for vehicle, seen in enumerate(story.seen[:, number].tolist())
        if seen or number < story.mapped  # nobody looks for what nobody has mapped
    ]
    return contributions(passes, rules)


def _at(begin: datetime, vehicle: int, number: int) -> datetime:
    return begin + timedelta(hours=vehicle, seconds=5 * number)


def _place(number: int) -> tuple[float, float]:
    lon, lat = _FRAME.to_geographic(np.array([_SPACING_M * number, 0.0]))
    return float(lon), float(lat)


def _number_of(detail: dict[str, Any], story: Story) -> int:
    if detail["kind"] == "deleted":
        return int(detail["map_object_id"]) - 1
    x = float(_FRAME.to_local(*detail["geometry"]["coordinates"][:2])[0])
    return max(round(x / _SPACING_M), story.mapped)


def _sign(number: int) -> MapFeature:
    lon, lat = _place(number)
    return MapFeature(object_id=number + 1, lon=round(lon, 8), lat=round(lat, 8), sign="SPEED_LIMIT", value="80")


def _message(story: Story, vehicle: int, begin: datetime) -> ReportMessage:
    passes = []
    for number, seen in enumerate(story.seen[vehicle].tolist()):
        mapped = number < story.mapped
        if not seen and not mapped:
            continue
        found = DetectionStatus.EXPECTED_AND_DETECTED if mapped else DetectionStatus.NOT_EXPECTED_AND_DETECTED
        at = _at(begin, vehicle, number)
        passes.append(
            PassReport(
                started_at=at - timedelta(seconds=3),
                ended_at=at,
                status=found if seen else DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE,
                weight_for=FULL_WEIGHT if seen else 0.0,
                weight_against=0.0 if seen else FULL_WEIGHT,
                sign="SPEED_LIMIT",
                value="80",
                reference=MapReference(0, number + 1) if mapped else None,
                position=MeasuredPosition(*_place(number), (0.3, 0.0, 0.3)) if seen else None,
                frames_detected=10 if seen else 0,
                frames_missed=0 if seen else 10,
            )
        )
    return ReportMessage(f"law-{vehicle}", 1, tuple(passes), last_of_session=True, map_identity=_MAP)


def _tell(cloud: Cloud, key: str, message: ReportMessage) -> None:
    folder = cloud.scratch / message.session_id
    folder.mkdir()
    with Server(cloud.url, key) as server, Outbox(folder / "outbox.sqlite") as outbox:
        outbox.put(message.session_id, [lambda _: serialize_message(message)], closes=True)
        Uploader(outbox, server, rng=np.random.default_rng(0)).flush(_TIMEOUT_S)
