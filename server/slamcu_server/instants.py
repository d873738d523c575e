"""Times that clients send: RFC 3339 text with a zone."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AwareDatetime, BeforeValidator

_BARE_NUMBER = re.compile(r"[-+]?\d+(\.\d*)?")


def _no_number(value: object) -> object:
    """Refuse a bare number, which pydantic would take for seconds, or milliseconds, since 1970."""
    if isinstance(value, bool | int | float) or (isinstance(value, str) and _BARE_NUMBER.fullmatch(value.strip())):
        raise ValueError("expected a date and time with its zone, such as 2026-05-01T08:00:00Z, not a number")
    return value


Instant = Annotated[AwareDatetime, BeforeValidator(_no_number)]
"""An instant that a client names; a number, which may be of seconds or of milliseconds, is none."""
