"""What a batch asks the database does not grow with what is stored: every large table is probed through an index."""

from __future__ import annotations

import re
from typing import Any

import asyncpg
import pytest
from sqlalchemy import event

pytestmark = pytest.mark.anyio

LARGE = ("features", "feature_versions", "feature_states", "passes", "messages", "candidates", "changes")
FILL = (
    # a map, and what was reported about it before
    """INSERT INTO features (map_id, object_id) SELECT :m, n FROM generate_series(1000, 8999) n""",
    """INSERT INTO feature_versions (feature_id, from_sequence, map_id, feature_class, sign, existence_confidence,
        position_std_m, geom)
    SELECT id, 1, :m, 'traffic_sign', 'SPEED_LIMIT', 0.95, 0.15,
        ST_SetSRID(ST_MakePoint(3.0 + 0.001 * (object_id % 200), 48.0 + 0.001 * (object_id / 200)), 4326)
    FROM features WHERE object_id >= 1000""",
    """INSERT INTO messages (account_id, session_id, message_id, sha256, state)
    SELECT :a, 'before', n, '', 'fused' FROM generate_series(1, 4000) n""",
    """INSERT INTO passes (message, index_in_message, map_id, contributor_id, started_at, ended_at, status,
        feature_class, weight_for, weight_against, frames_detected, frames_missed, frames_blocked, feature_id,
        map_sequence, sensor_model, software_version, fleet_id, valid, trusted, geom, cov_xx, cov_xy, cov_yy)
    SELECT m.id, k, :m, :a, '2026-04-01', '2026-04-01',
        CASE k WHEN 0 THEN 'EXPECTED_AND_DETECTED' ELSE 'NOT_EXPECTED_AND_DETECTED' END, 'traffic_sign',
        3, 0, 9, 0, 0, CASE k WHEN 0 THEN f.id END, 1, '', '', '', true, true,
        ST_SetSRID(ST_MakePoint(4.0 + 0.001 * (m.message_id % 100), 48.0 + 0.001 * (m.message_id / 100)), 4326), 1, 0, 1
    FROM messages m CROSS JOIN generate_series(0, 1) k LEFT JOIN features f ON f.object_id = 1000 + m.message_id
    WHERE m.session_id = 'before'""",
    """INSERT INTO candidates (map_id, feature_class, geom, cov_xx, cov_xy, cov_yy, weight_for, weight_against,
        standing, contributors_for, contributors_against, passes, founding_pass, policy_version)
    SELECT map_id, feature_class, geom, 1, 0, 1, 1, 0, false, 1, 0, 1, id, '' FROM passes WHERE feature_id IS NULL""",
    """UPDATE passes p SET candidate_id = c.id FROM candidates c WHERE c.founding_pass = p.id""",
    """INSERT INTO feature_states (feature_id, weight_for, weight_against, standing, contributors_for,
        contributors_against, passes, looked, blocked, policy_version)
    SELECT id, 5, 0, false, 1, 0, 1, 1, 0, '' FROM features WHERE object_id >= 1000""",
    """INSERT INTO changes (map_id, kind, state, candidate_id, revision, document, geom, salt)
    SELECT map_id, 'new', 'candidate', id, 1, '{}', geom, '' FROM candidates""",
)


async def test_a_batch_scans_no_large_table(town: Any, reports: Any) -> None:
    account = await town.account("a")
    for statement in FILL:
        await town.do(
            statement, **{name: v for name, v in (("m", town.map_id), ("a", account)) if f":{name}" in statement}
        )
    for table in LARGE:
        await town.do(f"ANALYZE {table}")
    for car in ("a", "b"):
        await town.report(car, reports.find(30, 0, hours=0), *(reports.missed(1, hours=number) for number in range(3)))
    await town.fuse()
    watched = (await town.rows("SELECT max(id) FROM candidates"))[0][0]
    asked: list[tuple[str, Any]] = []
    await town.engine.dispose()  # for connections that tell
    event.listen(
        town.engine.sync_engine,
        "connect",
        lambda connection, _: connection.driver_connection.add_query_logger(
            lambda told: asked.append((told.query, told.args or ()))
        ),
    )
    for car in ("c", "d"):
        await town.report(
            car, reports.seen(1, hours=30), reports.find(60, 0, hours=30), reports.seen(watched, hours=30, watched=True)
        )
    asked.clear()
    await town.fuse()
    assert len(asked) > 20
    connection = await asyncpg.connect(town.engine.url.render_as_string(False).replace("+asyncpg", ""))
    try:
        await connection.execute("SET plan_cache_mode = force_generic_plan")
        for statement, _ in asked:
            if "CREATE TEMPORARY TABLE" in statement:
                await connection.execute(statement)
        scanned = [
            f"{found.group(1)}: {' '.join(statement.split())}"
            for statement, parameters in asked
            if re.match(r"\s*(SELECT|INSERT|UPDATE|DELETE)", statement)
            for line in [
                *await connection.fetch(f"EXPLAIN {statement}", *parameters),
                *await _planned_once(connection, statement, len(parameters)),
            ]
            if (found := re.search(r"Seq Scan on (\w+)", line[0])) and found.group(1) in LARGE
        ]
    finally:
        await connection.close()
    assert scanned == []


async def _planned_once(connection: Any, statement: str, parameters: int) -> Any:
    """Return how a statement is carried out whatever is asked, as a batch has it."""
    await connection.execute(f"PREPARE asked AS {statement}")
    given = f"({', '.join(['NULL'] * parameters)})" if parameters else ""
    lines = await connection.fetch(f"EXPLAIN EXECUTE asked{given}")
    await connection.execute("DEALLOCATE asked")
    return lines
