"""What must hold, asked from outside: over HTTP, of the outboxes, and of `slamcu-server check`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import Any

from slamcu_client import Server
from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import join_batch, serialize_message
from slamcu_eval.commands.score import claims_from
from slamcu_eval.fleet import Provider, fused_result, standing_changes
from slamcu_eval.scenario.records import Sent, read_outbox
from slamcu_eval.scenario.system import Car, System, SystemFaultError
from slamcu_eval.scenario.world import Stage
from slamcu_eval.score import HIGHWAY_RADIUS_M, Score, score

_AT_ONCE = 200


def require(condition: bool, text: str) -> None:
    """Raise SystemFaultError with the text unless the condition holds."""
    if not condition:
        raise SystemFaultError(text)


def check(system: System, *options: str) -> dict[str, Any]:
    """Return what `slamcu-server check` prints; raise SlamcuError if it finds something amiss."""
    found: dict[str, Any] = json.loads(system.command("check", *options))
    return found


def everything_arrived(system: System, cars: Sequence[Car]) -> int:
    """Prove that every message that cars ever made is stored once and fused, and return how many they are.

    The outboxes say what was made, and that all of it was acknowledged. Over HTTP each message is sent again under its
    ids with other bytes: only what is stored is refused as a contradiction. `check` counts: no message more.
    """
    sent = {car.name: read_outbox(car) for car in cars}
    for name, one in sent.items():
        require(one.closed and bool(one.sessions), f"{name} has not come to the end of its drive: {one}")
        made = len(one.keys)
        settled = (one.pending, one.acknowledged, one.rejected, one.dropped)
        require(settled == (0, made, 0, 0), f"{name} made {made} messages, but its outbox says {one}")
    for car in cars:
        _require_stored(system, car, sent[car.name])
    keys = [key for one in sent.values() for key in one.keys]
    require(len(keys) == len(set(keys)), "two cars made messages of one session")
    found = check(system)
    wanted = {session: last for one in sent.values() for session, last in one.sessions.items()}
    stored = {session: number for session, number in found["sessions"].items() if session in wanted}
    require(stored == wanted, f"the outboxes sent {wanted}, the log holds {stored}")
    require(found["messages"] == {"fused": sum(found["sessions"].values())}, f"not all is fused: {found['messages']}")
    return len(keys)


def _require_stored(system: System, car: Car, sent: Sent) -> None:
    with Server(system.url, car.key_file.read_text(encoding="utf-8").strip()) as server:
        _, answer = server.exchange("GET", "/v1/maps")
        maps = json.loads(answer.content)["maps"]
        version = next(one["version"] for one in maps if one["source"] == car.map_name)
        keys = sorted(sent.keys)
        for first in range(0, len(keys), _AT_ONCE):
            some = keys[first : first + _AT_ONCE]
            bodies = [_contradiction(key, MapIdentity(car.map_name, version)) for key in some]
            headers = {"Content-Type": "application/x-protobuf", "Accept": "application/json"}
            _, answer = server.exchange("POST", "/v1/data-messages", headers=headers, content=join_batch(bodies))
            said = json.loads(answer.content)
            reasons = [one["reason"] for one in said.get("rejected", ())]
            require(
                reasons == ["conflicting-bytes"] * len(some),
                f"{car.name}: of {len(some)} acknowledged messages not all are stored; the server answered {said}",
            )


def _contradiction(key: tuple[str, int], identity: MapIdentity) -> bytes:
    """Return a message with the ids of another and nothing in it."""
    stamp = f"asked at {datetime.now(UTC).isoformat()}"
    return serialize_message(ReportMessage(*key, vehicle_id=stamp, map_identity=identity))


def feed_is_whole(provider: Provider) -> int:
    """Prove that the feed, read page by page, has every number from 1 once and in order, and return the last."""
    numbers = [entry["sequence"] for page in provider.pages("/v1/changes", {"limit": "7"}) for entry in page["entries"]]
    require(numbers == list(range(1, len(numbers) + 1)), f"the feed has a gap or a repetition: {numbers}")
    return len(numbers)


def told_against_truth(provider: Provider, stage: Stage) -> Score:
    """Compare what the service says of the map with what is so."""
    claims = claims_from(fused_result(provider, stage.name), stage.world.frame)
    return score(stage.facts, claims, radius_m=HIGHWAY_RADIUS_M)


def kinds_are_right(provider: Provider, stage: Stage) -> Score:
    """Prove that every change is told as what it is, and nothing else is told."""
    found = told_against_truth(provider, stage)
    told = zip(stage.facts, found.said, strict=True)
    wrong = [f"sign {fact.object_id} is {truth} and told as {said}" for fact, (truth, said) in told if truth != said]
    require(not wrong and not found.false_new, f"{'; '.join(wrong)}; {len(found.false_new)} false new signs")
    return found


def nothing_is_open(provider: Provider, stage: Stage) -> None:
    """Prove that no change stands that waits for a review."""
    standing = standing_changes(provider, stage.name)
    found = [f"{one['kind']} {one['sign']} ({one['state']})" for one in standing if one["state"] == "confirmed"]
    require(not found, f"there is still something to review: {', '.join(found)}")


def pending(system: System) -> int:
    """Return how many messages wait to be fused."""
    found: int = check(system)["messages"].get("pending", 0)
    return found


def equal(before: dict[str, Any], after: dict[str, Any], ignoring: Iterable[str] = ()) -> None:
    """Prove that two looks over the database found the same."""
    skipped = set(ignoring)
    different = [name for name in before if name not in skipped and before[name] != after.get(name)]
    require(not different, f"not the same as before: {', '.join(different)}")
