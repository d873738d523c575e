"""Bring a database to the newest schema, and tell whether it is there."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, text
from sqlalchemy.exc import DBAPIError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.errors import SlamcuError

_LOCK = 0x736C616D6375  # "slamcu": one migration at a time
_LOCK_TIMEOUT = "10s"  # for a table's lock: rather give up than hold up everyone who queues behind


class MigrationError(SlamcuError):
    """The database's schema is not the one this server works with."""


def migrations_dir() -> Path:
    """Return where the migrations are: inside the installed package, or at the top of the repository."""
    here = Path(__file__).resolve()
    for candidate in (here.parents[1] / "migrations", here.parents[3] / "migrations"):
        if (candidate / "env.py").exists():
            return candidate
    raise MigrationError("this installation of slamcu-server is incomplete: its migrations are missing")


def config(connection: Connection | None = None) -> Config:
    """Return alembic's configuration, working on `connection` if given."""
    configuration = Config()
    configuration.set_main_option("script_location", str(migrations_dir()).replace("%", "%%"))
    configuration.set_main_option("path_separator", "os")
    if connection is not None:
        configuration.attributes["connection"] = connection
    return configuration


@cache
def head() -> str:
    """Return the newest schema's revision."""
    revision = ScriptDirectory.from_config(config()).get_current_head()
    assert revision is not None  # noqa: S101  (there is a first migration)
    return revision


def known(revision: str) -> bool:
    """Tell whether this server has the migration `revision`."""
    return any(script.revision == revision for script in ScriptDirectory.from_config(config()).walk_revisions())


async def current(connection: AsyncConnection) -> str | None:
    """Return the database's revision; None if it is empty."""
    return await connection.run_sync(lambda sync: MigrationContext.configure(sync).get_current_revision())


async def _migrate(engine: AsyncEngine, step: Callable[[Config], None]) -> None:
    try:
        async with engine.begin() as connection:
            # Whoever comes second waits here, without a timeout, and then finds nothing left to do.
            await connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
            await connection.execute(text(f"SET LOCAL lock_timeout = '{_LOCK_TIMEOUT}'"))
            await connection.run_sync(lambda sync: step(config(sync)))
    except DBAPIError as error:
        if error.connection_invalidated:
            raise
        raise MigrationError(f"the migration failed and changed nothing: {str(error.orig).splitlines()[0]}") from error


async def upgrade(engine: AsyncEngine, revision: str = "head") -> None:
    """Bring the database up to `revision` in one transaction; safe while other processes do the same.

    Raises MigrationError if a step fails, with nothing changed.
    """
    await _migrate(engine, lambda configuration: command.upgrade(configuration, revision))


async def downgrade(engine: AsyncEngine, revision: str) -> None:
    """Take the database back to `revision` in one transaction; the tables' contents may be lost.

    Raises MigrationError if a step fails, with nothing changed.
    """
    await _migrate(engine, lambda configuration: command.downgrade(configuration, revision))


async def write_revision(engine: AsyncEngine, message: str) -> Path:
    """Write the migration from the database's schema, which is the newest, to that of the tables, for review by hand.

    For developers: the file is put among the migrations of this installation.
    """
    number = 1 + sum(1 for _ in ScriptDirectory.from_config(config()).walk_revisions())

    def write(connection: Connection) -> Path:
        script = command.revision(config(connection), message, autogenerate=True, rev_id=f"{number:04}")
        assert script is not None  # noqa: S101  (one revision is asked for)
        assert not isinstance(script, list)  # noqa: S101
        return Path(script.path)

    async with engine.connect() as connection:
        return await connection.run_sync(write)


async def require_head(engine: AsyncEngine) -> None:
    """Raise MigrationError if the database is behind this server; one that is ahead is left to its newer servers."""
    async with engine.connect() as connection:
        revision = await current(connection)
    if revision is None or (known(revision) and revision != head()):
        found = f"at revision {revision}" if revision else "empty"
        raise MigrationError(f"the database is {found}, this server needs {head()}: run slamcu-server migrate")
