"""What the log may hold of an error: never what a vehicle reported, or when and where it drove."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Iterator
from types import TracebackType

import asyncpg
from sqlalchemy.exc import StatementError

_DRIVERS = ("asyncpg.", "sqlalchemy.dialects.")
_DEEPEST = 20  # errors in a chain that are shown

ExceptionInfo = tuple[type[BaseException], BaseException, TracebackType | None] | tuple[None, None, None]


def told(error: BaseException) -> str:
    """Return an error in words that hold no data: of the database's, its class, SQLSTATE and constraint only.

    PostgreSQL and its driver quote values in what they say: of a parameter, of the row that breaks a constraint.
    """
    if not _quotes(error):
        return f"{type(error).__name__}: {error}"
    origin = next((one for one in _causes(error) if isinstance(one, asyncpg.PostgresError)), None)
    if origin is None:
        origin = getattr(error, "orig", None) or error
    known = [("SQLSTATE", getattr(origin, "sqlstate", None)), ("constraint", getattr(origin, "constraint_name", None))]
    details = ", ".join(f"{name} {value}" for name, value in known if value)
    return f"{type(origin).__name__} ({details})" if details else type(origin).__name__


class DiscreetFormatter(logging.Formatter):
    """Write tracebacks whose errors are told (`told`) instead of quoted."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as a line, and the traceback that belongs to it."""
        record.exc_text = None  # of another formatter, which may quote
        return super().format(record)

    def formatException(self, ei: ExceptionInfo) -> str:  # noqa: N802  (logging's name)
        """Return the chain of errors, the one that was logged last, as Python prints it."""
        if ei[1] is None:
            return ""
        chain = list(_causes(ei[1]))[:_DEEPEST]
        return "\n\n".join(_traced(error) for error in reversed(chain))


def _traced(error: BaseException) -> str:
    lines = ["Traceback (most recent call last):\n", *traceback.format_tb(error.__traceback__), told(error)]
    if isinstance(error, BaseExceptionGroup):
        lines += [f"\nof which one is:\n{_traced(one)}" for one in error.exceptions]
    return "".join(lines)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and what it came from, one after the other."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)


def _quotes(error: BaseException) -> bool:
    return isinstance(error, StatementError) or type(error).__module__.startswith(_DRIVERS)
