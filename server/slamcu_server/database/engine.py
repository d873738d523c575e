"""The connection pool."""

from __future__ import annotations

from typing import Any

from sqlalchemy import URL, event
from sqlalchemy.ext.asyncio import AsyncEngine, create_async_engine

from slamcu_server.database.url import driver_arguments, parse_url


def create_engine(url: str | URL, *, application_name: str = "slamcu", pool_size: int = 10) -> AsyncEngine:
    """Create the pool of connections to `url`, which `parse_url` takes.

    Behind PgBouncer add ``?prepared_statement_cache_size=0&statement_cache_size=0`` to the URL.
    """
    engine = create_async_engine(
        parse_url(url) if isinstance(url, str) else url,
        pool_size=pool_size,
        max_overflow=0,
        hide_parameters=True,  # they would be quoted in errors
        pool_pre_ping=True,  # the database may have been restarted since a connection was last used
        pool_timeout=10,
        connect_args={
            "timeout": 10,
            # jit costs more than it saves on short queries
            "server_settings": {"application_name": application_name, "jit": "off", "timezone": "UTC"},
        },
    )

    @event.listens_for(engine.sync_engine, "do_connect")
    def _(_dialect: object, _record: object, _positional: object, arguments: dict[str, Any]) -> None:
        driver_arguments(arguments)

    return engine
