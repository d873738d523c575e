"""How alembic runs the migrations: on the connection that slamcu_server.database.migrate hands it."""

from alembic import context
from geoalchemy2 import alembic_helpers
from sqlalchemy import Connection

from slamcu_server.database.tables import metadata


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


if context.is_offline_mode():
    raise SystemExit("migrations run on a database; writing them out as SQL is not supported")
run(context.config.attributes["connection"])
