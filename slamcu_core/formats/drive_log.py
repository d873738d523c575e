"""Drive logs: one JSON object a line, the header first, then records in order of time.

Reading is streamed: the header at once, each record when it is asked for. Opening files, and unpacking them, is the
caller's: any iterable of lines will do.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from functools import partial

from slamcu_core.drive import DriveHeader, Record
from slamcu_core.errors import FormatError
from slamcu_core.formats.drive_header import HeaderContext, header_to_json, read_header
from slamcu_core.formats.drive_records import RECORD_READERS, record_to_json
from slamcu_core.formats.fields import Fields, Place, parse_json
from slamcu_core.formats.lines import numbered_lines
from slamcu_core.records import check_record

__all__ = ["read_drive_log", "write_drive_log"]


def read_drive_log(lines: Iterable[str | bytes], *, source: str | None = None) -> tuple[DriveHeader, Iterator[Record]]:
    """Read a drive log.

    Positions in a local frame become longitude and latitude. Records of unknown type, and unknown fields, are
    passed over.

    Parameters
    ----------
    lines : the lines of the log, as text or UTF-8; a file opened in either mode is one.
    source : the log's name, for errors.

    Raises FormatError with line and field: here for the header, while iterating for a record.
    """
    numbered = numbered_lines(lines, source)
    first = next(numbered, None)
    if first is None:
        raise FormatError("the drive log is empty, expected a header", source=source, line=1)
    number, text = first
    place = Place(source, number)
    context = read_header(Fields(parse_json(text, place), place))
    return context.header, _records(numbered, context, source)


def write_drive_log(header: DriveHeader, records: Iterable[Record]) -> Iterator[str]:
    """Iterate over the lines of a drive log, each with its newline; positions are written in WGS84."""
    yield _line(header_to_json(header))
    for record in records:
        yield _line(record_to_json(record))


def _records(numbered: Iterator[tuple[int, str]], context: HeaderContext, source: str | None) -> Iterator[Record]:
    latest = 0.0
    for number, text in numbered:
        place = Place(source, number)
        fields = Fields(parse_json(text, place), place)
        kind = fields.text("type")
        if kind == "header":
            raise place.error("a second header, expected records", "type")
        reader: Callable[[Fields, HeaderContext], Record] | None = RECORD_READERS.get(kind)
        if reader is None:
            continue
        record = reader(fields, context)
        fields.checked(partial(check_record, record, context.sensors, wheelbase_m=context.header.wheelbase_m))
        if record.t < latest:
            raise place.error(f"time runs backwards: {record.t:g} s after {latest:g} s", "t")
        latest = record.t
        yield record


def _line(document: dict[str, object]) -> str:
    return json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(", ", ": ")) + "\n"
