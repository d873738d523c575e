"""What a network has sent, read so that nothing in it can do harm: JSON of any kind, and texts for logs."""

from __future__ import annotations

import json
from typing import Any

TEXT_LIMIT = 300
"""Longest text of a server that is stored or logged, in characters."""


def parse_json(content: bytes) -> Any:
    """Return the value of a JSON text; raises ValueError for whatever is none, nested without end included."""
    try:
        return json.loads(content)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def one_line(text: str, limit: int = TEXT_LIMIT) -> str:
    """Return a text as one printable line of at most `limit` characters.

    The words of a server must not be able to forge lines of a log or to command a terminal, and no half of a surrogate
    pair gets into a file.
    """
    printable = "".join(character if character.isprintable() else " " for character in text[: 4 * limit])
    return " ".join(printable.split())[:limit]
