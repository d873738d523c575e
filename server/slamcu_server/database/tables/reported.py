"""What was reported: the message log, the passes read out of it, and the candidates that they found."""

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
    Table,
    Text,
    UniqueConstraint,
    func,
    text,
)

from slamcu_server.database.tables.columns import created, metadata, point

messages = Table(
    "messages",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("account_id", BigInteger, ForeignKey("accounts.id"), nullable=False),
    Column("session_id", Text, nullable=False),
    Column("message_id", BigInteger, nullable=False),
    Column("sha256", LargeBinary, nullable=False),
    Column("body", LargeBinary),  # one serialized DataMessage; emptied when its retention ends
    Column("received_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("state", Text, nullable=False, server_default="pending"),
    Column("processed_at", DateTime(timezone=True)),
    Column("error", Text),
    Column("region", BigInteger, nullable=False, server_default=text("0")),  # where it is from; orders work, no more
    Column("condensed", LargeBinary),  # what it reports, until it is fused: slamcu_server.aggregation.condensed
    UniqueConstraint("account_id", "session_id", "message_id"),
    CheckConstraint("state IN ('pending', 'fused', 'quarantined')", name="state"),
)
Index("ix_messages_pending", messages.c.id, postgresql_where=text("state = 'pending'"))
Index(
    "ix_messages_bodies",
    messages.c.processed_at,
    postgresql_where=text("state = 'fused' AND body IS NOT NULL"),
)
Index("ix_messages_quarantined", messages.c.id, postgresql_where=text("state = 'quarantined'"))

# What is left of messages in the end (slamcu_server.aggregation.forgetting), and how far that has gone.
forgotten_messages = Table(
    "forgotten_messages",
    metadata,
    Column("ids", LargeBinary, primary_key=True),  # digest of account, session and message id
    Column("content", LargeBinary, nullable=False),  # digest of the bytes
)
forgetting = Table(
    "forgetting",
    metadata,
    Column("id", Boolean, primary_key=True, server_default=text("true")),
    Column("key", LargeBinary, nullable=False),  # of the digests
    Column("swept_to", BigInteger, nullable=False, server_default=text("0")),  # the message up to which was looked
    Column("swept_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    CheckConstraint("id", name="single"),
)

candidates = Table(
    "candidates",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),  # the object id of its watch feature
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("feature_class", Text, nullable=False),
    Column("sign", Text),
    Column("value", Text),
    point(),
    Column("cov_xx", Double, nullable=False),
    Column("cov_xy", Double, nullable=False),
    Column("cov_yy", Double, nullable=False),
    Column("weight_for", Double, nullable=False),
    Column("weight_against", Double, nullable=False),
    Column("standing", Boolean, nullable=False),
    Column("contributors_for", Integer, nullable=False),
    Column("contributors_against", Integer, nullable=False),
    Column("passes", Integer, nullable=False),
    Column("first_seen", DateTime(timezone=True)),
    Column("last_seen", DateTime(timezone=True)),
    Column("last_looked", DateTime(timezone=True)),
    Column("last_informative", DateTime(timezone=True)),
    # The pass that this id is bound to for ever; no foreign key, because a pass points to its candidate.
    Column("founding_pass", BigInteger, nullable=False, unique=True),
    Column("merged_into", BigInteger, ForeignKey("candidates.id")),  # whose founding pass is now another candidate's
    Column("feature_id", BigInteger, ForeignKey("features.id")),  # accepted into the map as this feature
    Column("policy_version", Text, nullable=False),
    created(),
    Column("fades_at", DateTime(timezone=True)),  # when it stands no longer if nobody looks again
    Column("pair_feature_id", BigInteger, ForeignKey("features.id")),  # the map feature with which it is one change
    Column("pair_kind", Text),
    CheckConstraint("pair_kind IN ('moved', 'modified')", name="pair_kind"),
)
Index(
    "ix_candidates_geom",
    candidates.c.geom,
    postgresql_using="gist",
    postgresql_where=text("merged_into IS NULL AND feature_id IS NULL"),
)
Index("ix_candidates_pair", candidates.c.pair_feature_id, postgresql_where=text("pair_feature_id IS NOT NULL"))

passes = Table(
    "passes",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    # What a pass names is there, or it would not have been resolved. Foreign keys would check it row by row again, for
    # more than all else that storing a pass costs.
    Column("message", BigInteger, nullable=False),
    Column("index_in_message", Integer, nullable=False),
    Column("map_id", BigInteger, nullable=False),
    Column("contributor_id", BigInteger, nullable=False),
    Column("started_at", DateTime(timezone=True), nullable=False),
    Column("ended_at", DateTime(timezone=True), nullable=False),
    Column("status", Text, nullable=False),
    Column("feature_class", Text, nullable=False),
    Column("sign", Text),
    Column("value", Text),
    Column("weight_for", Double, nullable=False),
    Column("weight_against", Double, nullable=False),
    Column("frames_detected", Integer, nullable=False),
    Column("frames_missed", Integer, nullable=False),
    Column("frames_blocked", Integer, nullable=False),
    Column("feature_id", BigInteger),  # the map feature it is about
    Column("watch_id", BigInteger),  # the watch feature it named
    Column("candidate_id", BigInteger),  # the candidate it now counts for
    point(nullable=True),
    Column("cov_xx", Double),
    Column("cov_xy", Double),
    Column("cov_yy", Double),
    Column("map_sequence", Integer, nullable=False),  # the map version that the vehicle compared with
    Column("sensor_model", Text, nullable=False),
    Column("software_version", Text, nullable=False),
    Column("fleet_id", Text, nullable=False),
    Column("valid", Boolean, nullable=False),  # False: seen, but crossed out or covered: no evidence
    Column("trusted", Boolean, nullable=False),  # the vehicle's own health; if not, many must agree (decision 0022)
    Column("archived", Boolean, nullable=False, server_default=text("false")),
    Column("retraction_id", BigInteger),  # what has taken it out: kept, not folded
    UniqueConstraint("message", "index_in_message"),
)
Index("ix_passes_feature", passes.c.feature_id, passes.c.ended_at, postgresql_where=text("feature_id IS NOT NULL"))
Index("ix_passes_candidate", passes.c.candidate_id, postgresql_where=text("candidate_id IS NOT NULL"))
Index("ix_passes_watch", passes.c.watch_id, postgresql_where=text("watch_id IS NOT NULL"))
Index("ix_passes_archived", passes.c.id, postgresql_where=text("archived"))
Index("ix_passes_retraction", passes.c.retraction_id, postgresql_where=text("retraction_id IS NOT NULL"))
Index(
    "ix_passes_unreferenced_geom",
    passes.c.geom,
    postgresql_using="gist",
    postgresql_where=text("feature_id IS NULL AND watch_id IS NULL AND NOT archived"),
)
