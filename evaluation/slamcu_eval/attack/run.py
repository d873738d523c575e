"""One attack: cars drive one after the other, report to the real server, and after each the feed is read."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from slamcu_client import MapCache, Server
from slamcu_core.errors import SlamcuError
from slamcu_core.formats import write_hd_map
from slamcu_core.hd_map import MapFeature
from slamcu_core.reports import Health, ReportMessage
from slamcu_core.sensoris import join_batch, serialize_message
from slamcu_eval.attack.cars import Car
from slamcu_eval.attack.judging import Feed
from slamcu_eval.attack.liars import Script, Sending, honest
from slamcu_eval.attack.operator import Operator
from slamcu_eval.attack.world import World
from slamcu_eval.fleet import Cloud

BETWEEN = timedelta(minutes=24)
"""Between two cars: sixty of them a day."""

TRUST_EVERY = {"random": 3, "liars_first": 2}
"""Cars after which trust is recomputed: a worker does it every hour, that is 2.5 cars; in random order it is rarer."""

BATCH = 100


@dataclass
class Answers:
    """What the server said to what was sent."""

    accepted: int = 0
    duplicates: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    throttled: int = 0  # requests answered with 429
    retry_after_s: float = 0.0


@dataclass
class Driver:
    """A car, its key, and what it does."""

    car: Car
    key: str
    script: Script = honest
    drives: int = 0

    @property
    def honest(self) -> bool:
        """Whether it means well."""
        return self.script is honest


class Road:
    """A world on a server, and the clock of those who drive there."""

    def __init__(self, cloud: Cloud, operator: Operator, world: World, drives: int, *, trust_every: int = 12) -> None:
        self._cloud, self._operator, self.world, self._trust_every = cloud, operator, world, trust_every
        path = cloud.scratch / f"{world.name}.geojson"
        path.write_text("".join(write_hd_map(world.identity, world.features())), encoding="utf-8")
        cloud.import_map(path)
        self.feed = Feed(cloud, world)
        self.answers = Answers()
        self._now = datetime.now(UTC) - timedelta(minutes=10) - BETWEEN * drives
        self._driven = 0

    @property
    def now(self) -> datetime:
        """When the next car sets out."""
        return self._now

    def drive(self, driver: Driver) -> None:
        """Let one car drive past all signs and report; wait until it is fused, and read the feed."""
        with Server(self._cloud.url, driver.key) as server:
            sent = driver.script(driver.car, self.world, self._watches(server), self._now, self._name(driver))
            self._send(server, sent, answers=None if driver.honest else self.answers)
        self._operator.wait_until_fused(600.0)
        driver.drives += 1
        self._driven += 1
        self._now += BETWEEN
        if self._driven % self._trust_every == 0:
            self._operator.recompute_trust()
        self.feed.read(honest=driver.honest)

    def flood(self, driver: Driver, passes: Sequence[Any], requests: int = 400) -> None:
        """Send the same large message until the server has had enough, or never has."""
        large = self._message(Sending(f"{self._name(driver)}-flood-{requests}", 1, tuple(passes)))
        with Server(self._cloud.url, driver.key) as server:
            for _ in range(requests):
                if not self._post(server, [large], self.answers):
                    return

    def _name(self, driver: Driver) -> str:
        return f"{self.world.name}-{driver.car.name}-{driver.drives}"

    def _watches(self, server: Server) -> list[MapFeature]:
        path = self._cloud.scratch / f"{self.world.name}-watches.geojson"
        path.unlink(missing_ok=True)
        hd_map = MapCache(path, server, self.world.name).refresh().hd_map
        return [feature for feature in hd_map if feature.watched]

    def _message(self, sending: Sending) -> bytes:
        return serialize_message(
            ReportMessage(
                session_id=sending.session,
                message_id=sending.number,
                passes=sending.passes,
                health=Health(trusted=sending.trusted),
                fleet_id="attack",
                map_identity=self.world.identity,
                sensor_model="passes",
                software_version="model",
            )
        )

    def _send(self, server: Server, sent: Sequence[Sending], answers: Answers | None) -> None:
        messages = [self._message(one) for one in sent]
        for begin in range(0, len(messages), BATCH):
            done = self._post(server, messages[begin : begin + BATCH], answers or Answers())
            if answers is None and not done:
                raise SlamcuError("the server refused what an honest car sent")

    @staticmethod
    def _post(server: Server, messages: Sequence[bytes], answers: Answers) -> bool:
        """Post messages, count the answers, and return whether the request was admitted."""
        _, answer = server.exchange(
            "POST",
            "/v1/data-messages",
            headers={"Content-Type": "application/x-protobuf"},
            content=join_batch(messages),
        )
        if answer.status == 429:
            answers.throttled += 1
            answers.retry_after_s = max(answers.retry_after_s, float(answer.headers["retry-after"]))
            return False
        if answer.status not in (202, 422):
            raise SlamcuError(f"the server answered {answer.status}: {answer.content.decode(errors='replace')[:300]}")
        said = json.loads(answer.content)
        answers.accepted += said["accepted"]
        answers.duplicates += said["duplicates"]
        for rejection in said["rejected"]:
            reason = rejection["reason"]
            answers.refused[reason] = answers.refused.get(reason, 0) + 1
        return True


def make_drivers(cloud: Cloud, count: int, scripts: Sequence[Script], rng: np.random.Generator) -> list[Driver]:
    """Make vehicles of their own accounts: first those that follow the scripts, then honest ones."""
    keys = cloud.create_keys("vehicle", count)
    return [
        Driver(Car(f"car-{number}", rng.spawn(1)[0]), key, scripts[number] if number < len(scripts) else honest)
        for number, key in enumerate(keys)
    ]
