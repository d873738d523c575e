"""A database for the cloud's bench: a map of any size, vehicles, what they have reported before, and a full log."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import asyncpg
import numpy as np

from slamcu_core.sensoris import serialize_message
from slamcu_eval.bench.traffic import MAP, ROAD_SQL, Traffic, stretch_at
from slamcu_server.aggregation.cells import region_at
from slamcu_server.aggregation.condensed import condense
from slamcu_server.aggregation.log import CHANNEL
from slamcu_server.aggregation.windows import COUNTS, FOUND
from slamcu_server.database import migrate
from slamcu_server.database.embedded import EmbeddedCluster
from slamcu_server.database.engine import create_engine

VEHICLES = 200

INSERT = """
INSERT INTO messages (account_id, session_id, message_id, sha256, body, region, condensed)
SELECT new.* FROM unnest($1::bigint[], $2::text[], $3::bigint[], $4::bytea[], $5::bytea[], $6::bigint[], $7::bytea[])
    AS new"""
"""Messages, as the ingest logs them."""
# What a fleet has reported before: one pass of each feature after the other, some by every vehicle, seen by nearly all.
# The beliefs beside the windows are placeholders until a pass is added: nothing but the windows is folded.
_HISTORY = f"""
WITH vehicle AS (SELECT id, row_number() OVER (ORDER BY id) AS number FROM accounts),
made AS (
    INSERT INTO passes (message, index_in_message, map_id, contributor_id, started_at, ended_at, status, feature_class,
        sign, value, weight_for, weight_against, frames_detected, frames_missed, frames_blocked, feature_id, geom,
        cov_xx, cov_xy, cov_yy, map_sequence, sensor_model, software_version, fleet_id, valid, trusted)
    SELECT $1, ((f.number - 1) * $2::bigint + k)::integer, f.map_id, a.id, at, at + interval '2 seconds',
        'EXPECTED_AND_DETECTED', 'traffic_sign', 'SPEED_LIMIT', '80', 3.0, 0.1, 24, 6, 0, f.id, f.geom,
        0.3, 0.0, 0.3, 1, 'bench', 'bench', '', true, true
    FROM (SELECT v.feature_id AS id, v.map_id, v.geom, row_number() OVER (ORDER BY v.feature_id) AS number
          FROM feature_versions v) f
    CROSS JOIN generate_series(1, $2::integer) k
    CROSS JOIN LATERAL (SELECT timestamptz '2023-01-01 UTC' + interval '5 hours' * k
                            + interval '1 second' * (f.number % 1000) AS at) t
    JOIN vehicle a ON a.number = 1 + (f.number * 7 + k * 31) % $3::integer
    RETURNING feature_id, contributor_id, ended_at, weight_for, weight_against
)
INSERT INTO feature_states (feature_id, weight_for, weight_against, standing, contributors_for, contributors_against,
    passes, looked, blocked, last_looked, last_seen, last_informative, policy_version, passes_window, window_at)
SELECT feature_id, 5.0, 0.2, false, 1, 0, count(*), count(*), 0, max(ended_at), max(ended_at), max(ended_at), 'filled',
    string_agg(int8send((extract(epoch FROM ended_at) * 1000000)::bigint) || int8send(contributor_id)
        || float8send(weight_for) || float8send(weight_against) || '\\x{COUNTS | FOUND:02x}'::bytea, ''
        ORDER BY ended_at), now()
FROM made GROUP BY feature_id"""  # noqa: S608  (constants)


@dataclass
class Cloud:
    """A database with the bench's map; rounds of traffic go into its log."""

    url: str  # SQLAlchemy's
    features: int
    seed: int
    accounts: list[int] = field(default_factory=list)
    _drives: int = 0

    @classmethod
    async def make(
        cls, cluster: EmbeddedCluster, name: str, features: int, *, seed: int = 0, stored_per_feature: int = 0
    ) -> Cloud:
        """Make a database `name` with a map, vehicles, and a number of stored passes over each map feature."""
        admin = await asyncpg.connect(_plain(cluster.url))
        try:
            await admin.execute(f'CREATE DATABASE "{name}"')
        finally:
            await admin.close()
        made = cls(cluster.url_of(name), features, seed)
        await migrated(made.url)
        connection = await made.connect()
        try:
            await make_map(connection, features)
            rows = await connection.fetch(
                "INSERT INTO accounts (role, label) SELECT 'vehicle', 'bench-' || n FROM generate_series(1, $1) n "
                "RETURNING id",
                VEHICLES,
            )
            made.accounts = [row["id"] for row in rows]
            if stored_per_feature:
                await made._store(connection, stored_per_feature)
            await connection.execute("VACUUM ANALYZE")
        finally:
            await connection.close()
        return made

    async def connect(self) -> asyncpg.Connection[Any]:
        """Return a connection of one's own."""
        return await asyncpg.connect(_plain(self.url), server_settings={"jit": "off", "timezone": "UTC"})

    async def fill_log(self, connection: asyncpg.Connection[Any], messages: int) -> int:
        """Log messages from all vehicles at one stroke, call the workers, and return how many passes they hold."""
        bodies, passes = await self.bodies(connection, messages)
        columns = list(zip(*bodies, strict=True))
        async with connection.transaction():
            await connection.execute(INSERT, *columns)
            await connection.execute("SELECT pg_notify($1, '')", CHANNEL)
        return passes

    async def bodies(
        self, connection: asyncpg.Connection[Any], messages: int
    ) -> tuple[list[tuple[int, str, int, bytes, bytes, int, bytes]], int]:
        """Return messages as rows of the log, and how many passes they hold; cars know the watch features there are."""
        rows = await connection.fetch(
            "SELECT id, ST_X(geom) AS lon, ST_Y(geom) AS lat FROM candidates "
            "WHERE merged_into IS NULL AND feature_id IS NULL AND contributors_for > 0 ORDER BY id"
        )
        watched = {stretch_at(row["lon"], row["lat"]): row["id"] for row in rows if _beside_road(row["lon"])}
        traffic, rng = Traffic(self.features, watched), np.random.default_rng((self.seed, self._drives))
        made: list[tuple[int, str, int, bytes, bytes, int, bytes]] = []
        passes = 0
        for number in range(messages):
            vehicle = number % len(self.accounts)
            for report in traffic.messages(vehicle, self._drives, 1, rng):
                body = serialize_message(report)
                session = f"drive-{self._drives}-{number}"
                region = next(region_at(one.position.lon, one.position.lat) for one in report.passes if one.position)
                digest = hashlib.sha256(body).digest()
                made.append((self.accounts[vehicle], session, 1, digest, body, region, condense(report)))
                passes += len(report.passes)
        self._drives += 1
        return made, passes

    async def _store(self, connection: asyncpg.Connection[Any], per_feature: int) -> None:
        """Store passes over every feature as if they had been fused, by one statement without the indexes."""
        definitions = await connection.fetch(
            "SELECT indexname, indexdef FROM pg_indexes WHERE tablename = 'passes' AND indexname LIKE 'ix%'"
        )
        for row in definitions:
            await connection.execute(f"DROP INDEX {row['indexname']}")
        message = await connection.fetchval(
            "INSERT INTO messages (account_id, session_id, message_id, sha256, state) "
            "VALUES ($1, 'history', 1, '', 'fused') RETURNING id",
            self.accounts[0],
        )
        await connection.execute(_HISTORY, message, per_feature, len(self.accounts))
        for row in definitions:
            await connection.execute(row["indexdef"])


async def make_map(connection: asyncpg.Connection[Any], features: int) -> None:
    """Write the bench's map straight into the tables, as an import would."""
    map_id = await connection.fetchval(
        "INSERT INTO maps (source, current_sequence, next_object_id) VALUES ($1, 1, $2) RETURNING id",
        MAP.source,
        features + 1,
    )
    await connection.execute(
        "INSERT INTO map_versions (map_id, sequence, version, origin) VALUES ($1, 1, $2, 'import')", map_id, MAP.version
    )
    await connection.execute(
        f"""
        WITH road AS ({ROAD_SQL}), made AS (
            INSERT INTO features (map_id, object_id) SELECT $2::bigint, object_id FROM road RETURNING id, object_id)
        INSERT INTO feature_versions (feature_id, from_sequence, map_id, feature_class, sign, value,
            existence_confidence, position_std_m, geom)
        SELECT made.id, 1, $2, 'traffic_sign', 'SPEED_LIMIT', '80', 0.95, 0.15,
            ST_SetSRID(ST_MakePoint(lon, lat), 4326)
        FROM road JOIN made USING (object_id)""",  # noqa: S608  (constants)
        features,
        map_id,
    )


async def migrated(url: str) -> None:
    """Bring a database to the newest schema."""
    engine = create_engine(url)
    try:
        await migrate.upgrade(engine)
    finally:
        await engine.dispose()


def quantiles(values: Sequence[float]) -> dict[str, float]:
    """Return the median, the 95th percentile and the largest of some values."""
    table = np.array(values)
    return {"median": float(np.median(table)), "p95": float(np.quantile(table, 0.95)), "max": float(table.max())}


def _beside_road(lon: float) -> bool:
    """Whether a candidate stands where the new signs do, and is no clutter between two roads."""
    return (lon - 2.0) % 0.003 < 0.0003


def _plain(url: str) -> str:
    return url.replace("+asyncpg", "")
