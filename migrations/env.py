"""How alembic runs the migrations: on the connection it is handed, else on the database of the settings."""

import asyncio

from alembic import context
from geoalchemy2 import alembic_helpers
from slamcu_server.database.tables import metadata
from slamcu_server.settings import Settings
from sqlalchemy import Connection, pool
from sqlalchemy.ext.asyncio import create_async_engine


def include_object(obj, name, kind, reflected, compare_to):
    # PostGIS brings tables of its own, such as spatial_ref_sys.
    if kind == "table" and reflected and name not in metadata.tables:
        return False
    return alembic_helpers.include_object(obj, name, kind, reflected, compare_to)


def run(connection: Connection) -> None:
    context.configure(
        connection=connection,
        target_metadata=metadata,
        include_object=include_object,
        process_revision_directives=alembic_helpers.writer,
        render_item=alembic_helpers.render_item,
        compare_type=True,
        compare_server_default=True,
    )
    with context.begin_transaction():
        context.run_migrations()


async def run_on_settings() -> None:
    url = Settings.load().database_url
    if url is None:
        raise SystemExit("set SLAMCU_DATABASE_URL, or run slamcu-server migrate")
    engine = create_async_engine(url, poolclass=pool.NullPool)
    async with engine.begin() as connection:
        await connection.run_sync(run)
    await engine.dispose()


if context.is_offline_mode():
    raise SystemExit("migrations run on a database; writing them out as SQL is not supported")
if (given := context.config.attributes.get("connection")) is not None:
    run(given)
else:
    asyncio.run(run_on_settings())
