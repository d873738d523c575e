"""What has been said: changes, and their entries in the feed."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Identity,
    Index,
    Integer,
    LargeBinary,
    Table,
    Text,
    UniqueConstraint,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

from slamcu_server.database.tables.columns import created, metadata, point

changes = Table(
    "changes",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("kind", Text, nullable=False),
    Column("state", Text, nullable=False),
    Column("feature_id", BigInteger, ForeignKey("features.id")),  # deleted, moved, modified: the map feature
    Column("candidate_id", BigInteger, ForeignKey("candidates.id")),  # new, moved, modified: the candidate
    Column("revision", Integer, nullable=False),  # rises with every entry: the ETag
    Column("document", JSONB, nullable=False),  # the change as last published
    point(),
    Column("salt", LargeBinary, nullable=False),  # of this change's pseudonyms
    Column("evidence_left", Boolean, nullable=False, server_default=text("false")),  # since its review
    created(),
    Column("updated_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("first_evidence_at", DateTime(timezone=True)),  # event time
    Column("mapped_at", DateTime(timezone=True)),  # when a version of the map first said so
    CheckConstraint("kind IN ('new', 'deleted', 'moved', 'modified')", name="kind"),
    CheckConstraint(
        "state IN ('candidate', 'confirmed', 'accepted', 'rejected', 'withdrawn', 'absorbed', 'contradicted')",
        name="state",
    ),
)
Index("ix_changes_open", changes.c.id, postgresql_where=text("state IN ('candidate', 'confirmed')"))
Index("ix_changes_feature", changes.c.feature_id)
Index("ix_changes_candidate", changes.c.candidate_id)
Index("ix_changes_geom", changes.c.geom, postgresql_using="gist")

change_entries = Table(
    "change_entries",
    metadata,
    Column("sequence", BigInteger, primary_key=True, autoincrement=False),  # gap-free, in order of commit
    Column("change_id", BigInteger, ForeignKey("changes.id", ondelete="CASCADE"), nullable=False),
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("revision", Integer, nullable=False),
    Column("kind", Text, nullable=False),
    Column("state", Text, nullable=False),
    Column("document", JSONB, nullable=False),
    point(),
    created(),
    UniqueConstraint("change_id", "revision"),
)
Index("ix_change_entries_geom", change_entries.c.geom, postgresql_using="gist")

feed_position = Table(
    "feed_position",
    metadata,
    Column("id", Boolean, primary_key=True, server_default=text("true")),
    Column("last_sequence", BigInteger, nullable=False),
    CheckConstraint("id", name="one_row"),
)
