"""A database's URL as documented and as others write it leads to a connection."""

from __future__ import annotations

import pytest
from sqlalchemy import text

from slamcu_server.database.engine import create_engine
from slamcu_server.settings import Settings

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize(
    ("parameters", "name", "jit"),
    [
        ("prepared_statement_cache_size=0&statement_cache_size=0", "slamcu", "on"),  # as docs/server.md has it
        ("sslmode=disable&connect_timeout=5&application_name=mine", "mine", "off"),
        ("sslmode=prefer", "slamcu", "off"),
    ],
)
async def test_parameters_of_the_url_are_understood(database_url: str, parameters: str, name: str, jit: str) -> None:
    plain = database_url.replace("postgresql+asyncpg://", "postgresql://")
    settings = Settings.load(database_url=f"{plain}&{parameters}")
    assert settings.connection_url is not None
    engine = create_engine(settings.connection_url)
    again = create_engine(engine.url)
    for each in (engine, again):
        async with each.connect() as connection:
            query = text("SELECT current_setting('application_name'), current_setting('jit'), CAST(:n AS int)")
            assert tuple((await connection.execute(query, {"n": 7})).one()) == (name, jit, 7)
            kept = await connection.scalar(text("SELECT count(*) FROM pg_prepared_statements WHERE name <> ''"))
            assert (kept == 0) == (jit == "on")
        await each.dispose()


async def test_encryption_that_is_required_is_not_done_without(database_url: str) -> None:
    engine = create_engine(f"{database_url}&sslmode=verify-full")
    with pytest.raises(Exception, match=r"(?i)ssl|certificate|root"):
        async with engine.connect():
            pass
    await engine.dispose()
