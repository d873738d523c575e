"""The story: what happens, in order, and what must be true after each of it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from slamcu_client import Server, TransportError
from slamcu_core.formats import read_results
from slamcu_eval.fleet import CloudError, Provider
from slamcu_eval.scenario import proof, records
from slamcu_eval.scenario.plan import Plan
from slamcu_eval.scenario.reviewer import accept_confirmed
from slamcu_eval.scenario.system import APIS, WORKERS, Car, System, SystemFaultError
from slamcu_eval.scenario.timeline import Timeline
from slamcu_eval.scenario.world import Stage, set_stage

_POLL_S = 0.25


def tell(system: System, plan: Plan, timeline: Timeline) -> None:
    """Let it all happen to a running system, and stop the system at the end.

    Raises SlamcuError saying which promise was broken.
    """
    stage = set_stage(plan, system.home / "world")
    timeline(f"a road of {plan.length_km:g} km with {_count(fact.kind for fact in stage.facts)} signs")
    system.command("import-map", stage.map_file)
    first, second = _fleets(system, plan, stage)
    key = system.command("create-key", "--role", "provider", "--label", "provider").strip()
    with Server(system.url, key) as server:
        story = _Story(system, plan, timeline, stage, Provider(server))
        story.first_fleet(first)
        story.review()
        story.second_fleet(first, second)
        story.restore([*first, *second])
        story.becomes("all is well", lambda: not system.ailing())
        timeline("every service is healthy")
    begun = time.monotonic()
    late = system.stop()
    proof.require(not late, f"did not stop in order within ten seconds: {', '.join(late)}")
    timeline(f"everything stopped in order in {time.monotonic() - begun:.1f} s")


def _fleets(system: System, plan: Plan, stage: Stage) -> tuple[list[Car], list[Car]]:
    count = plan.cars + plan.second_cars
    output = system.command("create-key", "--role", "vehicle", "--label", "car", "--count", str(count))
    cars = []
    for number, line in enumerate(output.strip().split("\n")):
        folder = system.home / "cars" / f"{number:03d}"
        folder.mkdir(parents=True)
        pace = plan.pace if number < plan.cars else plan.second_pace
        car = Car(f"car-{number:03d}", stage.logs[number], folder, stage.name, pace, number)
        car.key_file.write_text(line.rsplit("\t", 1)[-1], encoding="utf-8")
        cars.append(car)
    return cars[: plan.cars], cars[plan.cars :]


@dataclass(frozen=True, slots=True)
class _Story:
    """The chapters, about one system on one stage."""

    system: System
    plan: Plan
    timeline: Timeline
    stage: Stage
    provider: Provider

    # --- the first fleet, and faults ----------------------------------------------------------------------------------

    def first_fleet(self, cars: Sequence[Car]) -> None:
        """Let the first fleet drive while services are killed and the network is cut."""
        for car in cars:
            self.system.start_car(car)
        self.becomes("the first fleet is on the road", lambda: self._on_the_road(cars))
        begun, lasts = time.monotonic(), self.stage.longest_s / self.plan.pace
        self.timeline(f"the first fleet is on the road: {len(cars)} cars, for {lasts:.0f} s")
        for share, service in self.plan.kills:
            _sleep_until(begun + share * lasts)
            self.system.kill(service)
            self.timeline(f"killed {service} (SIGKILL); {records.acknowledged(cars)} messages are acknowledged")
        _sleep_until(begun + self.plan.cut_at * lasts)
        self._cut(cars)
        self.becomes("what was killed is back", lambda: not self.system.ailing())
        self.timeline("what was killed is back, and every service is healthy")
        self.becomes("the first fleet is home", lambda: self.system.cars_under_way() == 0)
        self.timeline("the first fleet is home")
        self._wait_until_fused()
        count = proof.everything_arrived(self.system, cars)
        self.timeline(
            f"all {count} messages of the fleet are stored once and fused, and what is believed is their fold"
        )
        self.timeline(f"the feed has {proof.feed_is_whole(self.provider)} entries and no gap")
        found = proof.kinds_are_right(self.provider, self.stage)
        self.timeline(f"the truth is told: {_count(said for _, said in found.said)}, no false new sign")

    def _cut(self, cars: Sequence[Car]) -> None:
        under_way = self.system.cars_under_way()
        proof.require(under_way > 0, "the fleet was home before its network could be cut")
        self.system.cut_network()
        time.sleep(1.0)  # what was on its way when it was cut has come or is lost
        before = records.acknowledged(cars)
        self.timeline(f"cut the network between cars and API, with {under_way} cars under way")
        time.sleep(self.plan.cut_s)
        proof.require(records.acknowledged(cars) == before, "messages were acknowledged through a network that was cut")
        waiting = records.waiting(cars)
        proof.require(waiting > 0, "nothing waited in the outboxes while the network was cut")
        self.system.mend_network()
        self.timeline(f"mended the network after {self.plan.cut_s:.0f} s; {waiting} messages wait in the outboxes")

    # --- the provider, and the second fleet -------------------------------------------------------------------------

    def review(self) -> None:
        """Let the provider accept what is confirmed."""
        before = self.provider.map_summary(self.stage.name)
        accepted = accept_confirmed(self.provider, self.stage.name)
        after = self.provider.map_summary(self.stage.name)
        wanted = Counter(fact.kind for fact in self.stage.facts if fact.kind != "normal")
        proof.require(accepted == wanted, f"the provider accepted {dict(accepted)}, the truth is {dict(wanted)}")
        proof.require(after["sequence"] > before["sequence"], "accepting changes made no new version of the map")
        self.timeline(
            f"the provider accepted {_count(accepted.elements())}: version {before['version']} to {after['version']}"
        )

    def second_fleet(self, first: Sequence[Car], second: Sequence[Car]) -> None:
        """Let the second fleet drive the new map while the system is upgraded to its next release, one by one."""
        for car in second:
            self.system.start_car(car)
        self.becomes("the second fleet is on the road", lambda: self._on_the_road(second))
        self.timeline("the second fleet has fetched the new map and is on the road")
        self.system.migrate_to_next()
        self.timeline("the schema is that of the next release; all services are still of this one")
        self.becomes("all services are healthy on the next schema", lambda: not self.system.ailing())
        for service in (APIS[0], WORKERS[0]):
            self.system.upgrade(service)
            self.becomes(f"the upgraded {service} is healthy", lambda: not self.system.ailing())
        before = records.acknowledged(second)
        self.becomes(
            "reports arrive while old and new run side by side",
            lambda: records.acknowledged(second) > before or self.system.cars_under_way() == 0,
        )
        self.timeline(
            f"{APIS[0]} and {WORKERS[0]} are of the next release, the others of this one; cars report to both"
        )
        for service in (APIS[1], WORKERS[1]):
            self.system.upgrade(service)
            self.becomes(f"the upgraded {service} is healthy", lambda: not self.system.ailing())
        self.timeline("all services are of the next release")
        self.becomes("the second fleet is home", lambda: self.system.cars_under_way() == 0)
        self._wait_until_fused()
        count = proof.everything_arrived(self.system, [*first, *second])
        self.timeline(f"the second fleet is home; all {count} messages of both are stored once and fused")
        proof.feed_is_whole(self.provider)
        proof.nothing_is_open(self.provider, self.stage)
        features = {feature["id"] for feature in self.provider.features(self.stage.name)}
        wanted = sum(fact.kind != "deleted" for fact in self.stage.facts)
        proof.require(len(features) == wanted, f"the map has {len(features)} features, the road {wanted}")
        seen = Counter[str]()
        for car in second:
            with car.result.open("rb") as file:
                said = list(read_results(file))
            seen.update(str(feature.state) for feature in said)
            known = {feature.map_object_id for feature in said if feature.map_object_id is not None}
            proof.require(known == features, f"{car.name} did not drive with the map's new version")
        self.timeline(f"the second fleet's cars say {dict(seen)}; together they have nothing left to report")

    # --- backup and restore -------------------------------------------------------------------------------------------

    def restore(self, cars: Sequence[Car]) -> None:
        """Make a backup, destroy the database, and go on with the backup."""
        before = proof.check(self.system, "--digests")
        backup = self.system.home / "backup.dump"
        self.system.back_up(backup)
        self.timeline(f"backed up {sum(one['rows'] for one in before['tables'].values())} rows")
        self.system.destroy_and_restore(backup)
        self.timeline("destroyed the database and made it anew of the backup")
        after = proof.check(self.system, "--digests")
        proof.equal(before, after)
        self.becomes("the restored system serves", lambda: _serves(self.provider))
        proof.everything_arrived(self.system, cars)
        self.timeline("the restored database is equal row by row, and serves")

    # --- patience ---------------------------------------------------------------------------------------------------

    def becomes(self, what: str, true: Callable[[], bool]) -> None:
        """Wait until something is true; raise SystemFaultError if that takes too long."""
        deadline = time.monotonic() + self.plan.patience_s
        while not true():
            if time.monotonic() > deadline:
                raise SystemFaultError(f"it took more than {self.plan.patience_s:g} s until: {what}")
            time.sleep(_POLL_S)

    def _on_the_road(self, cars: Sequence[Car]) -> bool:
        self.system.cars_under_way()  # to be told of one that failed
        return all(car.outbox.exists() for car in cars)

    def _wait_until_fused(self) -> None:
        self.becomes("everything is fused", lambda: proof.pending(self.system) == 0)


def _serves(provider: Provider) -> bool:
    try:
        provider.get("/v1/maps")
    except (CloudError, TransportError):
        return False
    return True


def _sleep_until(instant: float) -> None:
    time.sleep(max(0.0, instant - time.monotonic()))


def _count(kinds: Iterable[str]) -> str:
    counts = Counter(kinds)
    return ", ".join(f"{number} {kind}" for kind, number in sorted(counts.items()))
