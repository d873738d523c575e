"""Look over everything that is stored: counts, the feed's numbers, beliefs against their passes, and digests."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import text
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import aside
from slamcu_server.aggregation.rebuild import differences
from slamcu_server.database import migrate
from slamcu_server.database.tables import metadata


@dataclass(frozen=True, slots=True)
class TableContent:
    """How many rows a table has, and a digest of them that does not depend on their order."""

    rows: int
    digest: str


@dataclass(frozen=True, slots=True)
class Findings:
    """What a look over the database found."""

    schema: str | None  # its revision
    messages: dict[str, int]  # by state
    sessions: dict[str, int]  # messages of each session
    passes: int
    feed_last_sequence: int
    feed_gaps: int  # numbers up to the last that no entry has
    put_aside: list[str]  # work that failed for a lasting reason: which, and why
    differences: list[str]  # between what is believed and the fold of the stored passes
    tables: dict[str, TableContent]  # empty unless asked for

    @property
    def sound(self) -> bool:
        """Whether nothing is amiss."""
        return not (self.feed_gaps or self.differences or self.messages.get("quarantined") or self.put_aside)

    def to_document(self) -> dict[str, Any]:
        """Return all of it for JSON."""
        return asdict(self)


async def look_over(engine: AsyncEngine, policy: Policy, *, digests: bool = False) -> Findings:
    """Look over the database and change nothing; with `digests`, every row of every table is read."""
    async with engine.connect() as connection:
        await connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
        async with connection.begin():
            by_state = await connection.execute(text("SELECT state, count(*) AS number FROM messages GROUP BY state"))
            by_session = await connection.execute(
                text("SELECT session_id, count(*) AS number FROM messages GROUP BY session_id")
            )
            last, entries = (
                await connection.execute(
                    text("""
                    SELECT (SELECT last_sequence FROM feed_position), (
                        SELECT count(*) FROM change_entries
                        WHERE sequence BETWEEN 1 AND (SELECT last_sequence FROM feed_position))""")
                )
            ).one()
            return Findings(
                schema=await migrate.current(connection),
                messages={row.state: row.number for row in by_state},
                sessions={row.session_id: row.number for row in by_session},
                passes=(await connection.execute(text("SELECT count(*) FROM passes"))).scalar_one(),
                feed_last_sequence=last,
                feed_gaps=last - entries,
                put_aside=[f"{one.work} {one.key}: {one.error}" for one in await aside.list_all(connection)],
                differences=await differences(engine, policy),
                tables={table.name: await _content(connection, table.name) for table in metadata.sorted_tables}
                if digests
                else {},
            )


async def _content(connection: AsyncConnection, table: str) -> TableContent:
    query = f"""
        SELECT count(*) AS rows, coalesce(md5(string_agg(row, '' ORDER BY row)), '') AS digest
        FROM (SELECT md5(t::text) AS row FROM "{table}" t) hashed"""  # noqa: S608  (a name of our own)
    found = (await connection.execute(text(query))).one()
    return TableContent(found.rows, found.digest)
