"""Work that failed for a lasting reason is put aside, as messages are quarantined, so that the rest goes on.

It is kept with the reason and tried again by itself, later each time, or at once when somebody asks for that.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.database.statements import text

_FIRST, _LAST = "1 minute", "6 hours"  # pauses before another attempt


class Work(StrEnum):
    """What may be put aside, and what its key names."""

    RETRACTION = "retraction"  # of a retraction: the listing of its passes
    CORRECTION = "correction"  # of a listed pass, with all that it is about
    FADING = "fading"  # of a change that may have faded


@dataclass(frozen=True, slots=True)
class PutAside:
    """Work that failed, and why."""

    work: Work
    key: int
    error: str
    attempts: int
    failed_at: datetime
    retry_at: datetime


def fresh(work: Work, key: str) -> str:
    """Return the SQL condition that the work of a key never failed."""
    return f"NOT EXISTS ({_aside(work, key)})"


def due(work: Work, key: str) -> str:
    """Return the SQL condition that the work of a key may be tried: it never failed, or long ago."""
    return f"NOT EXISTS ({_aside(work, key)} AND a.retry_at > now())"


def _aside(work: Work, key: str) -> str:
    return f"SELECT FROM put_aside a WHERE a.work = '{work}' AND a.key = {key}"


async def put(connection: AsyncConnection, work: Work, key: int, error: str) -> None:
    """Put work aside that has failed once more."""
    await connection.execute(
        text(f"""
        INSERT INTO put_aside AS a (work, key, error, retry_at)
        VALUES (:work, :key, :error, now() + interval '{_FIRST}')
        ON CONFLICT (work, key) DO UPDATE SET error = EXCLUDED.error, attempts = a.attempts + 1, failed_at = now(),
            retry_at = now() + LEAST(interval '{_FIRST}' * (2 ^ LEAST(a.attempts, 20)), interval '{_LAST}')"""),  # noqa: S608  (constants)
        {"work": work.value, "key": key, "error": error},
    )


async def done(connection: AsyncConnection, work: Work, keys: Iterable[int]) -> None:
    """Forget that work ever failed."""
    await connection.execute(
        text("DELETE FROM put_aside WHERE work = :work AND key = ANY(CAST(:keys AS bigint[]))"),
        {"work": work.value, "keys": sorted(keys)},
    )


async def drop_due(connection: AsyncConnection, work: Work, before: datetime) -> None:
    """Forget the failures of work that could be tried again before a time, and that nobody had to do any more."""
    await connection.execute(
        text("DELETE FROM put_aside WHERE work = :work AND retry_at <= :before"), {"work": work.value, "before": before}
    )


async def list_all(connection: AsyncConnection) -> list[PutAside]:
    """Return what is put aside, longest first."""
    rows = await connection.execute(text("SELECT * FROM put_aside ORDER BY failed_at, work, key"))
    return [PutAside(Work(row.work), row.key, row.error, row.attempts, row.failed_at, row.retry_at) for row in rows]


async def count(connection: AsyncConnection) -> dict[Work, int]:
    """Return how much is put aside of each kind of work."""
    rows = await connection.execute(text("SELECT work, count(*) AS number FROM put_aside GROUP BY work"))
    return dict.fromkeys(Work, 0) | {Work(row.work): row.number for row in rows}


async def retry(connection: AsyncConnection) -> None:
    """Let all that is put aside be tried at once."""
    await connection.execute(text("UPDATE put_aside SET retry_at = now() WHERE retry_at > now()"))
