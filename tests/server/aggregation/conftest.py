"""A small town on a real database: a map, cars that report, and what the service makes of it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.aggregation import ClassPolicy, Policy
from slamcu_core.geometry import LocalFrame
from slamcu_core.hd_map import MapIdentity
from slamcu_core.reports import DetectionStatus, Health, MapReference, MeasuredPosition, PassReport, ReportMessage
from slamcu_core.sensoris import serialize_message
from slamcu_server.aggregation import rebuild
from slamcu_server.aggregation.condensed import condense
from slamcu_server.aggregation.policy import remember_policy
from slamcu_server.aggregation.worker import BATCH_SIZE, drain
from slamcu_server.changes.rebase import Rebased, Survey, import_and_rebase
from slamcu_server.ingest.message_log import LogEntry, PostgresMessageLog

FULL = 3.0  # weight of a pass that leaves no doubt (λ = 0.95)
KNOWN = Policy(ClassPolicy(strangers_more=0))  # cars that need no record to be believed by the quorum
FRAME = LocalFrame(2.1, 48.9)
START = datetime(2026, 5, 1, 8, tzinfo=UTC)


def at(hours: float) -> datetime:
    return START + timedelta(hours=hours)


def place(x: float, y: float, std_m: float = 0.5) -> MeasuredPosition:
    """A place in metres east and north of the middle of the town."""
    lon, lat = FRAME.to_geographic((x, y))
    return MeasuredPosition(float(lon), float(lat), (std_m**2, 0.0, std_m**2))


@dataclass
class Town:
    """The town; `signs` of its map stand at given metres from its middle, with object ids from 1."""

    engine: AsyncEngine
    policy: Policy = field(default_factory=Policy)
    source: str = "town"
    map_id: int = 0
    _cars: dict[str, int] = field(default_factory=dict)
    _messages: dict[tuple[str, str], int] = field(default_factory=dict)
    _logged: int = 0

    async def rows(self, query: str, **parameters: Any) -> list[Any]:
        async with self.engine.begin() as connection:
            return list(await connection.execute(text(query), parameters))

    async def do(self, statement: str, **parameters: Any) -> None:
        async with self.engine.begin() as connection:
            await connection.execute(text(statement), parameters)

    async def scalar(self, query: str, **parameters: Any) -> Any:
        return (await self.rows(query, **parameters))[0][0]

    async def import_map(self, signs: Sequence[tuple[float, float]] = ((0.0, 0.0),)) -> None:
        async with self.engine.begin() as connection:
            await remember_policy(connection, self.policy)
            found = await connection.execute(
                text("INSERT INTO maps (source, current_sequence, next_object_id) VALUES (:s, 1, :n) RETURNING id"),
                {"s": self.source, "n": len(signs) + 1},
            )
            self.map_id = found.scalar_one()
            await connection.execute(
                text(
                    "INSERT INTO map_versions (map_id, sequence, version, origin) VALUES (:m, 1, '2026.05', 'import')"
                ),
                {"m": self.map_id},
            )
            for number, (x, y) in enumerate(signs, 1):
                where = place(x, y)
                await connection.execute(
                    text("""
                    WITH f AS (INSERT INTO features (map_id, object_id) VALUES (:m, :o) RETURNING id)
                    INSERT INTO feature_versions (feature_id, from_sequence, map_id, feature_class, sign,
                        existence_confidence, position_std_m, geom)
                    SELECT id, 1, :m, 'traffic_sign', 'SPEED_LIMIT', 0.95, 0.15,
                        ST_SetSRID(ST_MakePoint(:lon, :lat), 4326) FROM f"""),
                    {"m": self.map_id, "o": number, "lon": where.lon, "lat": where.lat},
                )

    async def account(self, car: str) -> int:
        if car not in self._cars:
            self._cars[car] = await self.scalar(
                "INSERT INTO accounts (role, label) VALUES ('vehicle', :label) RETURNING id", label=car
            )
        return self._cars[car]

    async def report(
        self,
        car: str,
        *passes: PassReport,
        session: str = "s",
        message_id: int | None = None,
        version: str = "2026.05",
        trusted: bool = True,
        **fields: Any,
    ) -> None:
        """Log one message, each other one as an older server does; `fields` are further fields of the message."""
        number = message_id or self._messages.get((car, session), 0) + 1
        self._messages[car, session] = number
        report = ReportMessage(
            session_id=session,
            message_id=number,
            passes=passes,
            map_identity=MapIdentity(self.source, version),
            health=Health(trusted=trusted),
            **fields,
        )
        self._logged += 1
        condensed = condense(report) if self._logged % 2 else None
        await self.log(car, session, number, serialize_message(report), condensed)

    async def log(self, car: str, session: str, message_id: int, body: bytes, condensed: bytes | None = None) -> None:
        account = await self.account(car)
        async with self.engine.begin() as connection:
            entry = LogEntry(session, message_id, body, condensed=condensed)
            await PostgresMessageLog(connection).append(account, [entry])

    async def fuse(self, batch_size: int = BATCH_SIZE) -> None:
        await drain(self.engine, self.policy, batch_size)
        waiting = await self.scalar("SELECT count(*) FROM messages WHERE state = 'pending'")
        assert waiting == 0

    async def fuse_some(self, batch_size: int) -> None:
        """Fuse beside others, who may hold what waits."""
        await drain(self.engine, self.policy, batch_size)

    async def candidates(self) -> list[Any]:
        return await self.rows("SELECT * FROM candidates WHERE merged_into IS NULL AND feature_id IS NULL ORDER BY id")

    async def feature_state(self, object_id: int) -> Any:
        found = await self.rows(
            "SELECT s.* FROM feature_states s JOIN features f ON f.id = s.feature_id WHERE f.object_id = :o",
            o=object_id,
        )
        return found[0] if found else None

    async def changes(self) -> list[Any]:
        return await self.rows("SELECT * FROM changes ORDER BY id")

    async def entries(self) -> list[Any]:
        return await self.rows(
            "SELECT sequence, change_id, kind, state, revision FROM change_entries ORDER BY sequence"
        )


def seen(object_id: int, hours: float, weight: float = FULL, watched: bool = False) -> PassReport:
    """A mapped (or watched) sign that was seen where it should be."""
    return PassReport(
        at(hours),
        at(hours) + timedelta(seconds=5),
        DetectionStatus.EXPECTED_AND_DETECTED,
        weight_for=weight,
        weight_against=0.0,
        sign="SPEED_LIMIT",
        reference=MapReference(-1 if watched else 1, object_id),
        frames_detected=50,
    )


def missed(object_id: int, hours: float, weight: float = FULL, watched: bool = False) -> PassReport:
    """A mapped (or watched) sign that was looked for and not there."""
    return replace(
        seen(object_id, hours, watched=watched),
        status=DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE,
        weight_for=0.0,
        weight_against=weight,
        frames_detected=0,
        frames_missed=50,
    )


def blocked(object_id: int, hours: float) -> PassReport:
    """A mapped sign behind a lorry; its weights would count if it were taken for a miss."""
    return replace(
        missed(object_id, hours),
        status=DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_BLOCKED,
        weight_against=0.0,
        frames_missed=0,
        frames_blocked=50,
    )


def find(x: float, y: float, hours: float, weight: float = FULL, std_m: float = 0.5, **changes: Any) -> PassReport:
    """A sign that the map does not have."""
    made = PassReport(
        at(hours),
        at(hours) + timedelta(seconds=5),
        DetectionStatus.NOT_EXPECTED_AND_DETECTED,
        weight_for=weight,
        weight_against=0.0,
        sign="STOP_SIGN",
        position=place(x, y, std_m),
        frames_detected=50,
    )
    return replace(made, **changes)


def find_missed(x: float, y: float, hours: float, weight: float = FULL) -> PassReport:
    """A car's own find that it looked for again in vain."""
    return find(
        x,
        y,
        hours,
        status=DetectionStatus.EXPECTED_AND_NOT_DETECTED_ACCESS_AVAILABLE,
        weight=0.0,
        weight_against=weight,
        frames_detected=0,
        frames_missed=50,
    )


Sign = tuple[float, float] | tuple[float, float, str]  # metres east and north of the middle, and what it says


def a_map(source: str, version: str, signs: Mapping[int, Sign]) -> str:
    """A map as a provider writes it: speed limits, where signs say nothing else, by their ids."""
    features = []
    for number, (x, y, *sign) in signs.items():
        where = place(x, y)
        features.append(
            {
                "type": "Feature",
                "id": number,
                "geometry": {"type": "Point", "coordinates": [where.lon, where.lat]},
                "properties": {"class": "traffic_sign", "sign": sign[0] if sign else "SPEED_LIMIT"},
            }
        )
    return json.dumps(
        {"type": "FeatureCollection", "map": {"source": source, "version": version}, "features": features}
    )


class Reports:
    """The makers of passes, for tests."""

    FRAME = FRAME
    FULL = FULL
    at = staticmethod(at)
    place = staticmethod(place)
    seen = staticmethod(seen)
    missed = staticmethod(missed)
    blocked = staticmethod(blocked)
    find = staticmethod(find)
    find_missed = staticmethod(find_missed)
    a_map = staticmethod(a_map)
    KNOWN = KNOWN


@pytest.fixture(scope="session")
def reports() -> type[Reports]:
    return Reports


@pytest.fixture
def worker(server_environment: dict[str, str]) -> Callable[[], AbstractContextManager[subprocess.Popen[bytes]]]:
    """Start a worker's process, which is killed (kill -9) at the end of the context."""

    @contextmanager
    def started() -> Iterator[subprocess.Popen[bytes]]:
        process = subprocess.Popen(
            [sys.executable, "-m", "slamcu_server", "worker"], env=server_environment, stdout=subprocess.DEVNULL
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()

    return started


@pytest.fixture
def policy() -> Policy:
    """The town's policy; where cars are no strangers to each other a module says `KNOWN`."""
    return Policy()


@pytest.fixture
async def town(engine: AsyncEngine, policy: Policy) -> Town:
    """A town with one mapped sign in its middle."""
    made = Town(engine, policy)
    await made.import_map()
    return made


@pytest.fixture
def imports(town: Town, tmp_path: Path) -> Callable[..., Awaitable[Rebased]]:
    """`await imports("2026.06", {1: (0.0, 0.0)}, survey=None)`: the town's next version, and what became of changes."""

    async def run(version: str, signs: Mapping[int, Sign], survey: Survey | None = None) -> Rebased:
        path = tmp_path / f"{version}.geojson"
        path.write_text(a_map(town.source, version, signs))
        async with town.engine.begin() as connection:
            _, rebased = await import_and_rebase(connection, town.policy, path, survey=survey)
        assert await rebuild.differences(town.engine, town.policy) == []
        return rebased

    return run
