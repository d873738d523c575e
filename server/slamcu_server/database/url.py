"""The URL of a database, as others write it, in the words of our driver."""

from __future__ import annotations

from typing import Any

from sqlalchemy import URL, make_url
from sqlalchemy.exc import ArgumentError

_SCHEMES = ("postgresql+asyncpg://", "postgresql://", "postgres://")
_SSL_MODES = ("disable", "allow", "prefer", "require", "verify-ca", "verify-full")
_COUNTS = ("statement_cache_size", "prepared_statement_cache_size", "max_cached_statement_lifetime",
           "max_cacheable_statement_size", "connect_timeout")  # fmt: skip
_TEXTS = ("host", "port", "application_name", "target_session_attrs", "passfile")
PORT_MAX = 65535


def parse_url(text: str) -> URL:
    """Return the SQLAlchemy URL of what is written as PostgreSQL's or SQLAlchemy's.

    Raises ValueError saying what is wrong, without what the URL holds: it may be a password.
    """
    scheme = next((one for one in _SCHEMES if text.startswith(one)), None)
    if scheme is None:
        raise ValueError("must begin with postgresql://; there is no other dialect")
    try:
        url = make_url(_SCHEMES[0] + text.removeprefix(scheme))
    except (ArgumentError, ValueError):
        raise ValueError("is no URL of the form postgresql://user:password@host:port/name") from None
    if url.port is not None and not 0 < url.port <= PORT_MAX:
        raise ValueError(f"the port must be from 1 to {PORT_MAX}")
    query = dict(url.query)
    if "sslmode" in query:
        query["ssl"] = query.pop("sslmode")
    for name, value in query.items():
        if name == "ssl":
            if value not in _SSL_MODES:
                raise ValueError(f"sslmode must be one of {', '.join(_SSL_MODES)}")
        elif name in _COUNTS:
            if not isinstance(value, str) or not (value.isascii() and value.isdecimal()):
                raise ValueError(f"{name} must be a whole number from 0")
        elif name not in _TEXTS:
            hint = "; certificates are named by PGSSLROOTCERT, PGSSLCERT, PGSSLKEY" if name.startswith("ssl") else ""
            known = ", ".join(("sslmode", *_COUNTS, *_TEXTS))
            raise ValueError(f"has a parameter that is not known; known are {known}{hint}")
    return url.set(query=query)


def driver_arguments(arguments: dict[str, Any]) -> None:
    """Turn what a URL says, which is text, into what asyncpg takes, in place."""
    for name in _COUNTS:
        if name in arguments:
            arguments[name] = int(arguments[name])
    server = dict(arguments.get("server_settings", {}))
    if "connect_timeout" in arguments:
        arguments["timeout"] = arguments.pop("connect_timeout") or None
    if "application_name" in arguments:
        server["application_name"] = arguments.pop("application_name")
    if arguments.get("prepared_statement_cache_size") == 0:
        # Behind PgBouncer: statements without names, which are nobody else's, and no settings that it does not know.
        arguments["prepared_statement_name_func"] = str
        server.pop("jit", None)
    arguments["server_settings"] = server
