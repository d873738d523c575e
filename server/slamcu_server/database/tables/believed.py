"""What is believed, under which policy, and how far contributors are trusted."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    Double,
    ForeignKey,
    Identity,
    Index,
    Integer,
    LargeBinary,
    PrimaryKeyConstraint,
    Table,
    Text,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

from slamcu_server.database.tables.columns import created, metadata

feature_states = Table(
    "feature_states",
    metadata,
    Column("feature_id", BigInteger, ForeignKey("features.id", ondelete="CASCADE"), primary_key=True),
    Column("weight_for", Double, nullable=False),
    Column("weight_against", Double, nullable=False),
    Column("standing", Boolean, nullable=False),  # evidence stands against the map: deleted
    Column("contributors_for", Integer, nullable=False),
    Column("contributors_against", Integer, nullable=False),
    Column("passes", Integer, nullable=False),
    Column("looked", BigInteger, nullable=False),  # passes that could see the place
    Column("blocked", BigInteger, nullable=False),  # passes that could not
    Column("last_looked", DateTime(timezone=True)),
    Column("last_seen", DateTime(timezone=True)),
    Column("last_informative", DateTime(timezone=True)),
    Column("policy_version", Text, nullable=False),
    Column("updated_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("fades_at", DateTime(timezone=True)),  # when it stands no longer if nobody looks again
    Column(
        "forgotten_looked", BigInteger, nullable=False, server_default=text("0")
    ),  # passes that are not kept any more
    Column("forgotten_blocked", BigInteger, nullable=False, server_default=text("0")),
    Column("passes_window", LargeBinary),  # the passes that it is folded from: slamcu_server.aggregation.windows
    Column("window_at", DateTime(timezone=True)),  # the updated_at that the window belongs to
)

trust_versions = Table(
    "trust_versions",
    metadata,
    Column("version", BigInteger, Identity(), primary_key=True),
    Column("judged", BigInteger, nullable=False),  # verdicts that it rests on
    created(),
)

trust = Table(  # what one version after the other says of contributors; who is not in it is trusted as the policy says
    "trust",
    metadata,
    Column("contributor_id", BigInteger, ForeignKey("accounts.id"), nullable=False),
    Column("from_version", BigInteger, ForeignKey("trust_versions.version"), nullable=False),
    Column("to_version", BigInteger),  # the first version that says otherwise; NULL: the newest says so
    Column("share", Double, nullable=False),  # of the policy's trust
    Column("proven", Boolean, nullable=False),  # has a record
    Column("proven_since", DateTime(timezone=True)),  # event time from which it counts; NULL: always
    Column("right_count", Integer, nullable=False),  # verdicts when the version was made
    Column("wrong_count", Integer, nullable=False),
    Column("right_claims", Integer, nullable=False),  # of these about candidates
    Column("wrong_claims", Integer, nullable=False),
    PrimaryKeyConstraint("contributor_id", "from_version"),
    CheckConstraint("share BETWEEN 0 AND 1", name="share"),
)
Index("ix_trust_current", trust.c.contributor_id, unique=True, postgresql_where=text("to_version IS NULL"))

policies = Table(
    "policies",
    metadata,
    Column("version", Text, primary_key=True),  # digest of the document
    Column("document", JSONB, nullable=False),
    created(),
)
