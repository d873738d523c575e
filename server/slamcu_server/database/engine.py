"""The connection pool."""

from __future__ import annotations

from sqlalchemy import URL
from sqlalchemy.ext.asyncio import AsyncEngine, create_async_engine


def create_engine(url: str | URL, *, application_name: str = "slamcu", pool_size: int = 10) -> AsyncEngine:
    """Create the pool of connections to `url` (postgresql+asyncpg).

    Behind PgBouncer add ``?prepared_statement_cache_size=0&statement_cache_size=0`` to the URL.
    """
    return create_async_engine(
        url,
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
