"""What is taken out again, and what is to be folded anew: a retraction's evidence counts nowhere while it is active."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Identity,
    Index,
    Integer,
    PrimaryKeyConstraint,
    Table,
    Text,
    func,
    text,
)

from slamcu_server.database.tables.columns import metadata

retractions = Table(
    "retractions",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("state", Text, nullable=False, server_default="requested"),
    # What it names: all that is not NULL must hold of a pass.
    Column("contributor_id", BigInteger, ForeignKey("accounts.id")),
    Column("session_id", Text),
    Column("fleet_id", Text),
    Column("software_version", Text),
    Column("event_from", DateTime(timezone=True)),  # end of the pass, from here on
    Column("event_until", DateTime(timezone=True)),  # and before this
    Column("reason", Text, nullable=False),
    Column("requested_by", BigInteger, ForeignKey("accounts.id")),  # NULL: the server itself, which gates a session
    Column("requested_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("applied_at", DateTime(timezone=True)),
    Column("passes", BigInteger),  # how many it took out when it was applied; NULL: not known yet
    Column("features", BigInteger),
    Column("candidates", BigInteger),
    Column("undo_reason", Text),
    Column("undone_by", BigInteger, ForeignKey("accounts.id")),
    Column("undo_requested_at", DateTime(timezone=True)),
    Column("undone_at", DateTime(timezone=True)),
    CheckConstraint(
        "state IN ('requested', 'applying', 'applied', 'undo_requested', 'undoing', 'undone')", name="state"
    ),
    CheckConstraint(
        "num_nonnulls(contributor_id, session_id, fleet_id, software_version, event_from, event_until) > 0",
        name="names_something",
    ),
)
Index(
    "ix_retractions_active",
    retractions.c.contributor_id,
    postgresql_where=text("state IN ('requested', 'applying', 'applied')"),
)

corrections = Table(  # passes that are to be looked at again, with all that they are about
    "corrections",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("pass_id", BigInteger, nullable=False),  # no foreign key: a pass that is gone needs no correction
    Column("retraction_id", BigInteger, ForeignKey("retractions.id"), index=True),  # NULL: trust has changed
)

put_aside = Table(  # what failed for a lasting reason, while the rest goes on: slamcu_server.aggregation.aside
    "put_aside",
    metadata,
    Column("work", Text, nullable=False),
    Column("key", BigInteger, nullable=False),  # of the retraction, the correction, or the change that may have faded
    Column("error", Text, nullable=False),  # in words that hold no data
    Column("attempts", Integer, nullable=False, server_default=text("1")),
    Column("failed_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("retry_at", DateTime(timezone=True), nullable=False),
    PrimaryKeyConstraint("work", "key"),
    CheckConstraint("work IN ('retraction', 'correction', 'fading')", name="work"),
)
