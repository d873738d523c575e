"""Rows to and from the database as arrays: one statement for a whole set, whatever its size."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]

_NUMERALS = ("bigint", "integer", "boolean", "float8")
"""What goes over as digits: the driver encodes an array element by element, three times as slowly."""


def unnest(types: Mapping[str, str], alias: str = "r") -> str:
    """Return the SQL of a table of arrays, one parameter and column for each name."""
    parts = ", ".join(array(name, kind) for name, kind in types.items())
    columns = ", ".join(f'"{name}"' for name in types)
    return f"unnest({parts}) AS {alias}({columns})"


def array(name: str, kind: str) -> str:
    """Return the SQL of one parameter that is an array, given as `given` returns it.

    To be unnested: in the condition of a scan it is read from its digits once more for each row.
    """
    return f"CAST(CAST(:{name} AS text) AS {kind}[])" if kind in _NUMERALS else f"CAST(:{name} AS {kind}[])"


def given(kind: str, values: Iterable[Any]) -> list[Any] | str:
    """Return the parameter of `array`."""
    listed = list(values)
    return f"{{{str(listed)[1:-1].replace('None', 'NULL')}}}" if kind in _NUMERALS else listed


def arrays(types: Mapping[str, str], rows: Sequence[Row]) -> dict[str, list[Any] | str]:
    """Return the parameters of `unnest`: the rows by column."""
    return {name: given(kind, (row[name] for row in rows)) for name, kind in types.items()}
