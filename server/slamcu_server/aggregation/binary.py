"""Rows for PostgreSQL's binary COPY, made of arrays instead of a tuple for each row.

A row is a count of fields, then each field with its length before it (the manual: COPY, file formats, binary format).
Fields of fixed length are laid out by numpy, those of other lengths follow them.
"""

from __future__ import annotations

import struct
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sqlalchemy.ext.asyncio import AsyncConnection

_BEGIN, _END = b"PGCOPY\n\xff\r\n\0" + bytes(8), b"\xff\xff"
_LENGTH = struct.Struct(">i")
_NULL = -1
_POSTGRES_EPOCH_US = 946_684_800_000_000  # 2000-01-01 UTC
_KINDS = {"bigint": ">i8", "integer": ">i4", "float8": ">f8", "timestamptz": ">i8", "boolean": ">u1"}
_POINT = np.dtype([("order", "u1"), ("type", "<u4"), ("srid", "<u4"), ("lon", "<f8"), ("lat", "<f8")])  # EWKB
_WGS84_POINT = 1, 0x20000001, 4326  # little endian, a point with a reference system, and which


@dataclass(frozen=True, slots=True)
class Column:
    """N values of one type of the database."""

    kind: str  # one of _KINDS, or point
    values: ArrayLike  # (N,), for times POSIX microseconds; for points (N, 2), degrees
    null: NDArray[np.bool_] | None = None  # (N,), where there is none


def text_field(value: str | bytes | None) -> bytes:
    """Return a text, or bytes, as a field."""
    if value is None:
        return _LENGTH.pack(_NULL)
    encoded = value.encode() if isinstance(value, str) else value
    return _LENGTH.pack(len(encoded)) + encoded


async def copy(
    connection: AsyncConnection,
    table: str,
    columns: Mapping[str, Column],
    rest: Sequence[str],
    tails: Sequence[bytes],
) -> None:
    """Copy N rows into a table, in no particular order.

    Parameters
    ----------
    rest : the names of the columns that `tails` hold.
    tails : (N,), the fields of these columns, one after the other as `text_field` makes them.
    """
    driver = (await connection.get_raw_connection()).driver_connection
    if driver is None:
        raise ConnectionError("the connection to copy rows on is closed")

    async def stream() -> AsyncIterator[bytes]:
        yield _BEGIN
        yield rows(list(columns.values()), tails, len(rest))
        yield _END

    await driver.copy_to_table(table, source=stream(), columns=[*columns, *rest], format="binary")


def rows(columns: Sequence[Column], tails: Sequence[bytes], fields_in_tail: int) -> bytes:
    """Return N rows, those with the same columns missing after each other."""
    missing = [column.null for column in columns if column.null is not None]
    codes = sum(
        (null.astype(np.int64) << number for number, null in enumerate(missing)), np.zeros(len(tails), np.int64)
    )
    _, first, pattern = np.unique(codes, return_index=True, return_inverse=True)
    made: list[bytes] = []
    for number, example in enumerate(first.tolist()):
        chosen = np.flatnonzero(pattern == number)
        present = [column.null is None or not column.null[example] for column in columns]
        raw = _fixed(columns, present, chosen, len(columns) + fields_in_tail)
        size = len(raw) // len(chosen)
        for at, row in enumerate(chosen.tolist()):
            made += raw[at * size : (at + 1) * size], tails[row]
    return b"".join(made)


def _fixed(columns: Sequence[Column], present: Sequence[bool], chosen: NDArray[np.intp], fields: int) -> bytes:
    """Return the fields of fixed length of some rows of which the same columns are present."""
    layout: list[tuple[str, str | np.dtype[np.void]]] = [("fields", ">i2")]
    for number, (column, there) in enumerate(zip(columns, present, strict=True)):
        layout.append((f"length{number}", ">i4"))
        if there:
            layout.append((f"value{number}", _POINT if column.kind == "point" else _KINDS[column.kind]))
    table = np.empty(len(chosen), np.dtype(layout))
    table["fields"] = fields
    for number, (column, there) in enumerate(zip(columns, present, strict=True)):
        table[f"length{number}"] = table.dtype[f"value{number}"].itemsize if there else _NULL
        if there and column.kind == "point":
            points, value = np.asarray(column.values)[chosen], table[f"value{number}"]
            value["order"], value["type"], value["srid"] = _WGS84_POINT
            value["lon"], value["lat"] = points.T
        elif there:
            values = np.asarray(column.values)[chosen]
            table[f"value{number}"] = values - _POSTGRES_EPOCH_US if column.kind == "timestamptz" else values
    return table.tobytes()
