"""SQL that is written out: each statement is read for its parameters once, not whenever it is executed."""

from __future__ import annotations

from functools import lru_cache

from sqlalchemy import TextClause
from sqlalchemy import text as _text


@lru_cache(maxsize=512)
def text(statement: str) -> TextClause:
    """Return SQLAlchemy's text of a statement. What is given must be constant: values go over as parameters."""
    return _text(statement)
