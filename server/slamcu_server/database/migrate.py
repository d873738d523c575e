"""Bring a database to the newest schema, and tell whether it is there."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
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


def _next(sync: Connection, target: str) -> str | None:
    """Return the revision that follows the database's on the way up to `target`; None at its end."""
    found = MigrationContext.configure(sync).get_current_revision()
    script = ScriptDirectory.from_config(config())
    ahead = [step.revision for step in script.iterate_revisions(target, found or "base")]
    return ahead[-1] if ahead else None


def _step(sync: Connection, target: str) -> str | None:
    """Take the database one revision up, and return which; None if there is nothing left to do."""
    revision = _next(sync, target)
    if revision is not None:
        command.upgrade(config(sync), revision)
    return revision


@asynccontextmanager
async def _alone(engine: AsyncEngine) -> AsyncIterator[AsyncConnection]:
    """Begin a transaction in which nobody else migrates; raise MigrationError if a statement of it fails."""
    try:
        async with engine.begin() as connection:
            # Whoever comes second waits here, without a timeout, and then goes on from where the first has come to.
            await connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
            await connection.execute(text(f"SET LOCAL lock_timeout = '{_LOCK_TIMEOUT}'"))
            yield connection
    except DBAPIError as error:
        if error.connection_invalidated:
            raise
        async with engine.connect() as connection:
            revision = await current(connection)
        reason = str(error.orig).splitlines()[0]
        raise MigrationError(
            f"the migration from {revision or 'nothing'} failed and changed nothing: {reason}"
        ) from error


async def upgrade(engine: AsyncEngine, revision: str = "head") -> None:
    """Bring the database up to `revision`, one transaction a migration; safe while other processes do the same.

    Raises MigrationError if one fails, which changes nothing; those before it stay, and the next call goes on there.
    """
    # Each by itself: a table that one has locked is not held while the next waits for another, or fills it.
    done: str | None = ""
    while done is not None:
        async with _alone(engine) as connection:
            done = await connection.run_sync(_step, revision)


async def downgrade(engine: AsyncEngine, revision: str) -> None:
    """Take the database back to `revision` in one transaction; the tables' contents may be lost.

    Raises MigrationError if a step fails, with nothing changed.
    """
    async with _alone(engine) as connection:
        await connection.run_sync(lambda sync: command.downgrade(config(sync), revision))


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
