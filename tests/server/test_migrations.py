"""The migrations make exactly the tables that the code knows, forwards and backwards, by however many at once."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from geoalchemy2 import alembic_helpers
from sqlalchemy import CheckConstraint, Connection, inspect, text
from sqlalchemy.ext.asyncio import AsyncEngine

from slamcu_core.errors import SlamcuError
from slamcu_server.database import migrate
from slamcu_server.database.engine import create_engine
from slamcu_server.database.tables import metadata

pytestmark = pytest.mark.anyio


def _differences(connection: Connection) -> list[object]:
    def include(obj: object, name: str | None, kind: str, reflected: bool, compare_to: object) -> bool:
        if kind == "table" and reflected and name not in metadata.tables:
            return name not in {"spatial_ref_sys", "alembic_version"}
        included = alembic_helpers.include_object(obj, name, kind, reflected, compare_to)  # type: ignore[no-untyped-call]  # GeoAlchemy2 has no types
        return bool(included)

    options = {"compare_type": True, "compare_server_default": True, "include_object": include}
    return list(compare_metadata(MigrationContext.configure(connection, opts=options), metadata))


def _check_constraints(connection: Connection) -> set[str]:
    query = """
        SELECT conname FROM pg_constraint JOIN pg_class ON pg_class.oid = conrelid
        WHERE contype = 'c' AND relname = ANY(:names)
    """
    return set(connection.execute(text(query), {"names": list(metadata.tables)}).scalars())


async def test_the_migrations_make_the_tables_of_the_code(engine: AsyncEngine) -> None:
    async with engine.connect() as connection:
        assert await connection.run_sync(_differences) == []
        # What alembic does not compare: check constraints.
        expected = {
            str(constraint.name)
            for table in metadata.tables.values()
            for constraint in table.constraints
            if isinstance(constraint, CheckConstraint)
        }
        assert await connection.run_sync(_check_constraints) == expected


async def test_a_difference_would_be_found(engine: AsyncEngine) -> None:
    async with engine.begin() as connection:
        await connection.execute(text("ALTER TABLE changes ADD COLUMN forgotten text"))
        await connection.execute(text("DROP INDEX ix_passes_watch"))
        assert len(await connection.run_sync(_differences)) == 2


_BEGIN_LIKE_ANOTHER = """
    SELECT shorter.indexrelid::regclass::text FROM pg_index shorter JOIN pg_index longer USING (indrelid)
    WHERE shorter.indexrelid <> longer.indexrelid AND NOT shorter.indisunique
    AND shorter.indpred IS NULL AND longer.indpred IS NULL AND shorter.indexprs IS NULL
    AND (longer.indkey::text || ' ') LIKE (shorter.indkey::text || ' %')
    AND (longer.indclass::text || ' ') LIKE (shorter.indclass::text || ' %')
    AND shorter.indrelid IN (SELECT oid FROM pg_class WHERE relname = ANY(:names))
"""


async def test_no_index_is_the_beginning_of_another(engine: AsyncEngine) -> None:
    async with engine.connect() as connection:
        result = await connection.execute(text(_BEGIN_LIKE_ANOTHER), {"names": list(metadata.tables)})
        assert result.scalars().all() == []


async def test_the_history_of_a_change_is_found_by_its_revisions(engine: AsyncEngine) -> None:
    async with engine.begin() as connection:
        map_id = await connection.scalar(
            text("INSERT INTO maps (source, current_sequence, next_object_id) VALUES ('m', 1, 1) RETURNING id")
        )
        place = "ST_SetSRID(ST_MakePoint(2, 48), 4326)"
        for statement in (
            f"""INSERT INTO changes (map_id, kind, state, revision, document, geom, salt)
            SELECT {map_id}, 'new', 'candidate', 4, '{{}}', {place}, '' FROM generate_series(1, 2000)""",
            f"""INSERT INTO change_entries (sequence, change_id, map_id, revision, kind, state, document, geom)
            SELECT row_number() OVER (), id, map_id, r, kind, state, document, {place}
            FROM changes CROSS JOIN generate_series(1, 4) r""",
            "ANALYZE change_entries",
        ):
            await connection.execute(text(statement))
        for statement in (
            "SELECT sequence, state, revision, created_at FROM change_entries WHERE change_id = 1 ORDER BY sequence",
            "DELETE FROM ONLY change_entries WHERE change_id = 1",  # as a change that goes takes them along
        ):
            plan = "\n".join((await connection.execute(text(f"EXPLAIN {statement}"))).scalars())
            assert "uq_change_entries_change_id_revision" in plan, plan


async def test_down_and_up_again(engine: AsyncEngine) -> None:
    await migrate.downgrade(engine, "base")
    async with engine.connect() as connection:
        left = await connection.run_sync(lambda sync: set(inspect(sync).get_table_names()))
        assert left <= {"spatial_ref_sys", "alembic_version"}
        assert await migrate.current(connection) is None
    with pytest.raises(SlamcuError, match="run slamcu-server migrate"):
        await migrate.require_head(engine)
    await migrate.upgrade(engine)
    await migrate.require_head(engine)
    async with engine.connect() as connection:
        assert await connection.run_sync(_differences) == []
        assert await migrate.current(connection) == migrate.head()


async def test_many_may_migrate_at_once(engine: AsyncEngine, database_url: str) -> None:
    await migrate.downgrade(engine, "base")
    engines = [create_engine(database_url) for _ in range(4)]
    await asyncio.gather(*(migrate.upgrade(one) for one in engines))
    for one in engines:
        await one.dispose()
    await migrate.require_head(engine)


async def test_a_table_in_use_is_not_waited_for_forever(engine: AsyncEngine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(migrate, "_LOCK_TIMEOUT", "50ms")
    async with engine.begin() as reader:
        await reader.execute(text("SELECT count(*) FROM accounts"))
        with pytest.raises(SlamcuError, match=r"changed nothing: .*lock timeout"):
            await migrate.downgrade(engine, "base")
    await migrate.require_head(engine)


@pytest.fixture
def two_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Two further migrations: one that changes the largest table, and one that needs another table."""
    copied = tmp_path / "migrations"
    shutil.copytree(migrate.migrations_dir(), copied)
    before = migrate.head()
    for revision, statement in (
        ("9001", "ALTER TABLE passes ADD COLUMN further text"),
        ("9002", "ALTER TABLE accounts ADD COLUMN further text"),
    ):
        (copied / "versions" / f"{revision}_further.py").write_text(
            f"from alembic import op\nrevision, down_revision = {revision!r}, {before!r}\n"
            f"def upgrade():\n    op.execute({statement!r})\n"
        )
        before = revision
    monkeypatch.setattr(migrate, "migrations_dir", lambda: copied)
    migrate.head.cache_clear()
    yield
    migrate.head.cache_clear()


@pytest.mark.usefixtures("two_more")
async def test_a_migration_that_waits_or_fails_holds_nothing_of_those_before_it(
    engine: AsyncEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(migrate, "_LOCK_TIMEOUT", "3s")
    async with engine.begin() as reader, engine.connect() as other:
        await reader.execute(text("SELECT count(*) FROM accounts"))
        migrating = asyncio.create_task(migrate.upgrade(engine))
        for _ in range(100):
            await asyncio.sleep(0.02)
            if await other.scalar(text("SELECT EXISTS (SELECT FROM pg_locks WHERE NOT granted)")):
                break
        await other.execute(text("SET LOCAL lock_timeout = '1s'"))
        assert await other.scalar(text("SELECT count(further) FROM passes")) == 0
        with pytest.raises(SlamcuError, match=r"from 9001 failed and changed nothing: .*lock timeout"):
            await migrating
    with pytest.raises(SlamcuError, match="at revision 9001, this server needs 9002"):
        await migrate.require_head(engine)
    await asyncio.gather(migrate.upgrade(engine), migrate.upgrade(engine))
    await migrate.require_head(engine)


def test_the_command_migrates_an_empty_database(
    command: Callable[..., subprocess.CompletedProcess[str]], database_url: str
) -> None:
    async def empty() -> None:
        engine = create_engine(database_url)
        await migrate.downgrade(engine, "base")
        await engine.dispose()

    asyncio.run(empty())
    for _ in range(2):  # the second finds nothing to do
        done = command("migrate")
        assert done.returncode == 0, done.stderr
        assert migrate.head() in done.stderr


def test_a_migration_is_written_for_what_has_changed(
    command: Callable[..., subprocess.CompletedProcess[str]],
    tmp_path: Path,
    database_url: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    copied = tmp_path / "migrations"
    shutil.copytree(migrate.migrations_dir(), copied)
    monkeypatch.setattr(migrate, "migrations_dir", lambda: copied)

    async def lose_a_column() -> None:
        engine = create_engine(database_url)
        async with engine.begin() as connection:
            await connection.execute(text("ALTER TABLE candidates DROP COLUMN sign"))
        await engine.dispose()

    asyncio.run(lose_a_column())
    done = command("new-migration", "Get the sign back")
    assert done.returncode == 0, done.stderr
    (written,) = set(copied.glob("versions/*get_the_sign_back.py"))
    assert 'add_column("candidates"' in written.read_text().replace("'", '"')
    head = migrate.head()
    migrate.head.cache_clear()
    try:
        assert migrate.head() == f"{int(head) + 1:04}"
    finally:
        migrate.head.cache_clear()
