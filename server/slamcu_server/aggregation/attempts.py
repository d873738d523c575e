"""Work that may fail: what passes by itself is tried again, and what does not is told from it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from slamcu_core.errors import SlamcuError
from slamcu_server.logs import told

logger = logging.getLogger(__name__)

T = TypeVar("T")

# SQLSTATE classes after which the same work may succeed: connection, rollback, resources, operator, system
_PASSING = ("08", "40", "53", "55", "57", "58")
_ATTEMPTS = 5  # at work that was rolled back for reasons that pass
_REASON_MAX = 2000


class BatchError(Exception):
    """A batch of work failed and left no trace; its cause says why."""

    def __init__(self, what: str, ids: Sequence[int]) -> None:
        super().__init__(f"a batch of {len(ids)} {what} failed")
        self.ids = tuple(ids)

    @property
    def reason(self) -> str:
        """Why, in words that hold nothing of what was reported."""
        return reason(self.__cause__ or self)


async def attempt(work: Callable[[], Awaitable[T]]) -> T:
    """Do a batch of work, again if it was rolled back for a reason that passes; raise such a reason if it stays.

    Raises BatchError where the work does, for any other reason.
    """
    for number in range(1, _ATTEMPTS + 1):
        try:
            return await work()
        except BatchError as failed:
            cause = failed.__cause__
            if cause is None or not transient(cause):
                raise
            if number == _ATTEMPTS or _lost(cause):
                raise cause from None
            logger.info("a batch was rolled back and is tried again: %s", told(cause))
            await asyncio.sleep(0.05 * 2**number)
    raise AssertionError("unreachable")


def reason(error: BaseException) -> str:
    """Return why something failed, to be stored."""
    words = str(error) if isinstance(error, SlamcuError) else told(error)
    return words.replace("\x00", "?")[:_REASON_MAX]  # which PostgreSQL cannot store


def transient(error: BaseException) -> bool:
    """Whether the same work may succeed later: nothing must be put aside for what the database suffers."""
    state = getattr(getattr(error, "orig", None), "sqlstate", None)
    return _lost(error) or (isinstance(state, str) and state.startswith(_PASSING))


def _lost(error: BaseException) -> bool:
    if isinstance(error, DBAPIError) and error.connection_invalidated:
        return True
    return isinstance(error, OSError | InterfaceError | PoolTimeoutError | MemoryError) or (
        isinstance(error, OperationalError) and getattr(error.orig, "sqlstate", None) is None
    )
