"""`slamcu-server check`: what is stored hangs together, and two databases can be compared."""

from __future__ import annotations

from typing import Any

import pytest
from sqlalchemy import text

from slamcu_server.database import migrate
from slamcu_server.integrity.service import look_over

pytestmark = pytest.mark.anyio


async def test_a_sound_database_is_told_in_figures(town: Any, reports: Any) -> None:
    for number in range(2):
        await town.report(f"car-{number}", reports.find(30, 0, hours=number))
    await town.fuse()
    await town.report("late", reports.missed(1, hours=3))
    found = await look_over(town.engine, town.policy)
    assert found.sound
    assert found.schema == migrate.head()
    assert found.messages == {"fused": 2, "pending": 1}
    assert sum(found.sessions.values()) == 3
    assert (found.passes, found.feed_last_sequence, found.feed_gaps) == (2, 1, 0)
    assert found.tables == {}


@pytest.mark.parametrize(
    ("damage", "amiss"),
    [
        ("DELETE FROM change_entries WHERE sequence = 1", "feed_gaps"),
        ("UPDATE candidates SET weight_for = weight_for + 0.001", "differences"),
        ("UPDATE messages SET state = 'quarantined'", "messages"),
    ],
)
async def test_what_is_amiss_is_found(town: Any, reports: Any, damage: str, amiss: str) -> None:
    for number in range(2):
        await town.report(f"car-{number}", reports.find(30, 0, hours=number))
    await town.fuse()
    before = (await look_over(town.engine, town.policy)).to_document()
    async with town.engine.begin() as connection:
        await connection.execute(text(damage))
    found = await look_over(town.engine, town.policy)
    assert not found.sound
    assert [name for name, value in found.to_document().items() if value != before[name]] == [amiss]


async def test_digests_tell_every_difference_and_nothing_else(town: Any, reports: Any) -> None:
    await town.report("car", reports.find(30, 0, hours=0))
    await town.fuse()
    before = (await look_over(town.engine, town.policy, digests=True)).tables
    assert before["messages"].rows == 1
    assert (await look_over(town.engine, town.policy, digests=True)).tables == before
    async with town.engine.begin() as connection:
        await connection.execute(text("UPDATE messages SET received_at = received_at + interval '1 microsecond'"))
    after = (await look_over(town.engine, town.policy, digests=True)).tables
    assert [name for name in before if before[name] != after[name]] == ["messages"]
