"""Lines of text out of lines of bytes or text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from slamcu_core.errors import FormatError

_BOM = "\ufeff"


def numbered_lines(lines: Iterable[str | bytes], source: str | None) -> Iterator[tuple[int, str]]:
    """Iterate over lines with their numbers from 1; blank ones are passed over.

    Raises FormatError where bytes are not UTF-8.
    """
    for number, line in enumerate(lines, start=1):
        if isinstance(line, bytes):
            try:
                text = line.decode("utf-8")
            except UnicodeDecodeError as error:
                raise FormatError(
                    f"not UTF-8: byte {line[error.start]:#04x} at column {error.start + 1}", source=source, line=number
                ) from error
        else:
            text = line
        if number == 1:
            text = text.removeprefix(_BOM)
        if text.strip():
            yield number, text
