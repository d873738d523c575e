"""Reports, retractions, reviews, maps, trust and time in any order: what is believed is the fold of what counts."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from slamcu_core.aggregation import ClassPolicy, Policy
from slamcu_core.reports import PassReport
from slamcu_server.accounts.schemas import Principal, Role
from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.fading import fade
from slamcu_server.aggregation.worker import forget_archived
from slamcu_server.changes.rebase import Survey, import_and_rebase
from slamcu_server.changes.review import review
from slamcu_server.changes.schemas import ReviewRequest
from slamcu_server.retraction import corrections, marks, repository
from slamcu_server.retraction.filter import EvidenceFilter
from slamcu_server.trust.job import recompute

pytestmark = pytest.mark.anyio

SIGNS = {number: (60.0 * (number - 1), 0.0) for number in range(1, 11)}
PLACES = [(60.0 * number + 20.0 + shift, 5.0) for number in range(4) for shift in (0.0, 2.6)]  # of signs that are new
PROVIDER = Principal(0, Role.PROVIDER, "provider", "key")
CARS = [f"car-{number}" for number in range(9)]


@pytest.fixture
def policy() -> Policy:
    """Windows that overflow and beliefs that fade within the two weeks of a test."""
    return Policy(ClassPolicy(window=6, half_life_days=1.5, strangers_more=0, contributors_in_doubt=2))


@dataclass
class Walk:
    """What happens to a town, step by step, and what must hold after each."""

    town: Any
    reports: Any
    rng: random.Random
    directory: Path
    hours: float = 0.0
    versions: list[str] = field(default_factory=list)
    mapped: dict[int, tuple[Any, ...]] = field(default_factory=lambda: dict(SIGNS))
    ever: set[int] = field(default_factory=lambda: set(SIGNS))
    told: int = 0

    def _passes(self, known: list[int], watched: list[int]) -> list[PassReport]:
        rng, reports = self.rng, self.reports
        self.hours += rng.expovariate(1 / 3.0)
        hours = max(0.0, self.hours - rng.choice((0.0, 0.0, 0.0, 5.0, 40.0)))  # some come late
        made = [
            (reports.missed if rng.random() < 0.4 else reports.seen)(one, hours, weight=rng.uniform(0.0, 4.0))
            for one in rng.sample(known, min(3, len(known)))
        ]
        for x, y in rng.sample(PLACES, 3):
            place = (x + rng.gauss(0.0, 0.5), y + rng.gauss(0.0, 0.5))
            if rng.random() < 0.2:
                made.append(reports.find_missed(*place, hours=hours))
            else:
                sign = rng.choice(("STOP_SIGN", "STOP_SIGN", "SPEED_LIMIT"))
                weight, std_m = rng.uniform(0.5, 4.0), rng.uniform(0.3, 1.5)
                made.append(reports.find(*place, hours=hours, weight=weight, std_m=std_m, sign=sign))
        for one in rng.sample(watched, min(2, len(watched))):
            say = reports.missed if rng.random() < 0.4 else reports.seen
            x, y = rng.choice(PLACES)
            made.append(replace(say(one, hours, watched=True), sign="STOP_SIGN", position=reports.place(x, y, 0.8)))
        return made

    async def report(self) -> None:
        """Some cars tell what they saw, with the map that they have, trusted or not."""
        watched = [row.id for row in await self.town.rows("SELECT id FROM candidates")]
        for car in self.rng.sample(CARS, self.rng.randint(1, 4)):
            self.told += 1
            await self.town.report(
                car,
                *self._passes(sorted(self.ever), watched),
                session=f"s-{self.told // 6}",
                version=self.rng.choice(self.versions[-3:]),
                trusted=self.rng.random() < 0.85,
                fleet_id=f"fleet-{CARS.index(car) % 3}",
                software_version=self.rng.choice(("4.1", "4.2")),
            )

    async def lose(self) -> None:
        """A lost car misses all there is, and others pass: the stuff of gates, and of their opening."""
        self.hours += 1.0
        lost = self.rng.random() < 0.7
        for number, car in enumerate(self.rng.sample(CARS, 5)):
            say = self.reports.missed if (number == 1) is lost else self.reports.seen
            passes = [say(one, self.hours + 0.1 * number) for one in sorted(self.mapped)]
            self.told += 1
            await self.town.report(car, *passes, session=f"l-{self.told}", version=self.versions[-1])

    async def fuse(self) -> None:
        await self.town.fuse(self.rng.choice((1, 4, 64)))

    async def together(self) -> None:
        """Workers fuse and correct side by side."""
        piece = self.rng.choice((3, 200))
        await asyncio.gather(
            self.town.fuse_some(2),
            corrections.correct(self.town.engine, self.town.policy, piece),
            self.town.fuse_some(4),
        )

    async def retract(self) -> None:
        rng = self.rng
        names: dict[str, Any] = rng.choice(
            (
                {"fleet_id": f"fleet-{rng.randrange(3)}"},
                {"software_version": rng.choice(("4.1", "4.2"))},
                {"contributor_id": await self.town.account(rng.choice(CARS))},
                {"event_from": self.reports.at(self.hours - 30.0), "event_until": self.reports.at(self.hours - 3.0)},
            )
        )
        async with self.town.engine.begin() as connection:
            await marks.hold_alone(connection)
            await repository.add(connection, EvidenceFilter(**names), "a test", await self.town.account("admin"))

    async def undo(self) -> None:
        standing = await self.town.rows(
            f"SELECT id FROM retractions WHERE state IN {marks.ACTIVE} AND requested_by IS NOT NULL ORDER BY id"
        )
        if standing:
            async with self.town.engine.begin() as connection:
                await marks.hold_alone(connection)
                await repository.request_undo(connection, self.rng.choice(standing).id, "a test", None)

    async def correct(self) -> None:
        for _ in range(self.rng.randint(1, 5)):
            await corrections.correct(self.town.engine, self.town.policy, self.rng.choice((4, 30)))

    async def correct_all(self) -> None:
        await corrections.correct_all(self.town.engine, self.town.policy)

    async def trust(self) -> None:
        await recompute(self.town.engine, self.reports.at(self.hours))

    async def fade(self) -> None:
        self.hours += self.rng.choice((0.0, 60.0))
        await fade(self.town.engine, self.town.policy, clock_ahead=timedelta(days=4000))

    async def forget(self) -> None:
        await forget_archived(self.town.engine, timedelta(0))

    async def survey(self) -> None:
        """The provider's next version: signs come, go, are elsewhere, or say something else."""
        rng = self.rng
        # what reviews have made of the map is the provider's own
        self.mapped = {
            row.object_id: (*self._metres(row.lon, row.lat), row.sign)
            for row in await self.town.rows(
                """SELECT f.object_id, v.sign, ST_X(geom) AS lon, ST_Y(geom) AS lat FROM feature_versions v
                JOIN features f ON f.id = v.feature_id WHERE to_sequence IS NULL AND v.map_id = :map""",
                map=self.town.map_id,
            )
        }
        for _ in range(rng.randint(1, 3)):
            match rng.randrange(4):
                case 0:
                    x, y = rng.choice(PLACES)
                    self.mapped[rng.choice((max(self.ever) + 1, *self.ever))] = (x, y, "STOP_SIGN")
                case 1 if len(self.mapped) > 9:
                    del self.mapped[rng.choice(sorted(self.mapped))]
                case 2:
                    one = rng.choice(sorted(self.mapped))
                    x, y, *says = self.mapped[one]
                    self.mapped[one] = (x + rng.choice((0.2, 4.0)), y, *says)
                case _:
                    self.mapped |= {one: SIGNS[one] for one in rng.sample(sorted(SIGNS), 1)}
            self.ever |= self.mapped.keys()
        await self.publish()

    async def publish(self) -> None:
        """Import the provider's map."""
        name = f"survey-{len(self.versions)}"
        path = self.directory / f"{name}.geojson"
        path.write_text(self.reports.a_map("town", name, self.mapped))
        looked = Survey(self.reports.at(self.hours)) if self.rng.random() < 0.3 else None
        async with self.town.engine.begin() as connection:
            await import_and_rebase(connection, self.town.policy, path, survey=looked)
        self.versions.append(name)

    def _metres(self, lon: float, lat: float) -> tuple[float, float]:
        x, y = self.reports.FRAME.to_local(lon, lat)
        return float(x), float(y)

    async def review(self) -> None:
        waiting = await self.town.rows("SELECT id, revision FROM changes WHERE state IN ('candidate', 'confirmed')")
        if not waiting:
            return
        row = self.rng.choice(sorted(waiting))
        asked = ReviewRequest(decision=self.rng.choice(("accept", "reject")), reason="a test")
        etag = f'"{row.id}-{row.revision}"'
        await review(self.town.engine, self.town.policy, row.id, asked, if_match=etag, reviewer=PROVIDER)
        self.ever |= {one.object_id for one in await self.town.rows("SELECT object_id FROM features")}
        self.versions += [
            row.version
            for row in await self.town.rows("SELECT version FROM map_versions ORDER BY sequence DESC LIMIT 1")
            if row.version not in self.versions
        ]

    async def settle(self) -> None:
        """Nothing is under way any more: the feed says what is believed, and every pass counts for something."""
        await self.fuse()
        await self.correct_all()
        assert await self.town.scalar("SELECT count(*) FROM retractions WHERE state NOT IN ('applied', 'undone')") == 0
        await fade(self.town.engine, self.town.policy, clock_ahead=timedelta(days=4000))
        await self.hold()
        before = await self.said()
        assert await rebuild.rebuild(self.town.engine, self.town.policy) == 0, await self.news(before)
        assert await self.town.rows("SELECT error FROM messages WHERE state = 'quarantined'") == []
        assert await self.town.rows(_IDLE) == []
        assert await self.town.rows(_FOUNDERS) == []
        assert await self.town.rows(_SAID) == []
        sequences = [entry.sequence for entry in await self.town.entries()]
        assert sequences == list(range(1, len(sequences) + 1))

    async def said(self) -> int:
        return int(await self.town.scalar("SELECT last_sequence FROM feed_position"))

    async def news(self, before: int) -> list[Any]:
        return list(
            await self.town.rows(
                "SELECT change_id, kind, state, document FROM change_entries WHERE sequence > :before", before=before
            )
        )

    async def hold(self) -> None:
        """Every belief is the fold of what is kept and not taken out, once it is folded under the newest trust."""
        if await self.town.scalar("SELECT count(*) FROM corrections WHERE retraction_id IS NULL"):
            return
        assert await rebuild.differences(self.town.engine, self.town.policy) == []


# finds that count and are no candidate's nor map feature's; reports that name what is a candidate or map feature now
_IDLE = """
    SELECT p.id, p.status, p.watch_id, p.candidate_id, p.feature_id, root.id AS root, root.feature_id AS became
    FROM passes p LEFT JOIN candidates c ON c.id = p.watch_id
    LEFT JOIN candidates root ON root.id = COALESCE(c.merged_into, c.id) AND root.merged_into IS NULL
    WHERE NOT p.archived AND p.retraction_id IS NULL AND p.feature_id IS NULL AND CASE
        WHEN p.watch_id IS NULL THEN p.valid AND p.status = 'NOT_EXPECTED_AND_DETECTED' AND p.candidate_id IS NULL
        ELSE root.feature_id IS NOT NULL OR root.id IS NOT NULL AND p.candidate_id IS DISTINCT FROM root.id END"""
_FOUNDERS = """
    SELECT c.id, c.merged_into, p.retraction_id, p.archived, p.feature_id FROM candidates c
    LEFT JOIN passes p ON p.id = c.founding_pass
    WHERE c.feature_id IS NULL AND (p.id IS NULL OR c.merged_into IS NULL AND (
        p.retraction_id IS NOT NULL OR p.archived OR p.feature_id IS NOT NULL OR p.watch_id IS NOT NULL))
       OR c.merged_into <> c.id AND c.merged_into IN (SELECT id FROM candidates WHERE merged_into IS NOT NULL)"""
_SAID = """
    SELECT c.id, c.kind, c.state, c.feature_id, c.candidate_id FROM changes c
    LEFT JOIN candidates k ON k.id = c.candidate_id
    LEFT JOIN feature_versions v ON v.feature_id = c.feature_id AND v.to_sequence IS NULL
    WHERE c.state IN ('candidate', 'confirmed')
      AND (k.merged_into IS NOT NULL OR k.feature_id IS NOT NULL
           OR c.feature_id IS NOT NULL AND v.feature_id IS NULL)"""


@pytest.mark.parametrize("seed", range(2, 4))
async def test_whatever_happens_in_whatever_order(town: Any, reports: Any, tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    walk = Walk(town, reports, rng, tmp_path)
    await walk.publish()
    steps: list[tuple[Callable[[], Awaitable[None]], float]] = [
        (walk.report, 8), (walk.lose, 1), (walk.fuse, 5), (walk.together, 4), (walk.retract, 2), (walk.undo, 3),
        (walk.correct, 4), (walk.correct_all, 3), (walk.trust, 2), (walk.fade, 1), (walk.forget, 0.5),
        (walk.survey, 1), (walk.review, 3), (walk.settle, 1),
    ]  # fmt: skip
    for step in rng.choices([one for one, _ in steps], [often for _, often in steps], k=60):
        await step()
        await walk.hold()
    await walk.settle()
