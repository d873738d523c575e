"""Rows to and from the database as arrays: one statement for a whole set, whatever its size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]


def unnest(types: Mapping[str, str], alias: str = "r") -> str:
    """Return the SQL of a table of arrays, one parameter and column for each name."""
    arrays = ", ".join(f"CAST(:{name} AS {kind}[])" for name, kind in types.items())
    columns = ", ".join(f'"{name}"' for name in types)
    return f"unnest({arrays}) AS {alias}({columns})"


def arrays(types: Mapping[str, str], rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Return the parameters of `unnest`: the rows by column."""
    return {name: [row[name] for row in rows] for name in types}
