"""SQL that is written out: each statement is read for its parameters once, not whenever it is executed."""

from __future__ import annotations

from functools import lru_cache

from sqlalchemy import TextClause
from sqlalchemy import text as _text
from sqlalchemy.ext.asyncio import AsyncConnection


@lru_cache(maxsize=512)
def text(statement: str) -> TextClause:
    """Return SQLAlchemy's text of a statement. What is given must be constant: values go over as parameters."""
    return _text(statement)


async def plan_once(connection: AsyncConnection) -> None:
    """Let the database plan each statement once, until this transaction ends, instead of for each set of parameters.

    For work whose statements are the same and whose tables are probed through indexes whatever is asked.
    """
    await connection.execute(text("SET LOCAL plan_cache_mode = force_generic_plan"))
