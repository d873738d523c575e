"""The tables, in SQLAlchemy Core. `migrations/` makes them; a test holds the two together."""

from __future__ import annotations

from geoalchemy2 import Geometry
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
    MetaData,
    PrimaryKeyConstraint,
    Table,
    Text,
    UniqueConstraint,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def _point(*, nullable: bool = False) -> Column[object]:
    return Column("geom", Geometry("POINT", srid=4326, spatial_index=False), nullable=nullable)


def _created() -> Column[object]:
    return Column("created_at", DateTime(timezone=True), nullable=False, server_default=func.now())


# --- who: an account outlives its keys; a vehicle's account is one contributor ---------------------------------------

accounts = Table(
    "accounts",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("role", Text, nullable=False),
    Column("label", Text, nullable=False, unique=True),
    _created(),
    CheckConstraint("role IN ('vehicle', 'provider', 'admin')", name="role"),
)

api_keys = Table(
    "api_keys",
    metadata,
    Column("id", Text, primary_key=True),  # the public part of the key
    Column("account_id", BigInteger, ForeignKey("accounts.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("secret_sha256", LargeBinary, nullable=False),
    _created(),
    Column("expires_at", DateTime(timezone=True)),
    Column("revoked_at", DateTime(timezone=True)),
)

# --- what is mapped: feature identity is stable, its attributes are versioned by the map's sequence ------------------

maps = Table(
    "maps",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("source", Text, nullable=False, unique=True),
    Column("current_sequence", Integer, nullable=False),
    Column("next_object_id", BigInteger, nullable=False),
    Column("evidence_time", DateTime(timezone=True)),  # of the newest report that the housekeeping knows of
    _created(),
)

map_versions = Table(
    "map_versions",
    metadata,
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("sequence", Integer, nullable=False),
    Column("version", Text, nullable=False),
    Column("origin", Text, nullable=False),
    Column("change_id", BigInteger),  # the accepted change that made this version
    _created(),
    PrimaryKeyConstraint("map_id", "sequence"),
    UniqueConstraint("map_id", "version"),
    CheckConstraint("origin IN ('import', 'review')", name="origin"),
)

features = Table(
    "features",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("object_id", BigInteger, nullable=False),
    UniqueConstraint("map_id", "object_id"),
)

feature_versions = Table(
    "feature_versions",
    metadata,
    Column("feature_id", BigInteger, ForeignKey("features.id", ondelete="CASCADE"), nullable=False),
    Column("from_sequence", Integer, nullable=False),
    Column("to_sequence", Integer),  # the first version without it; NULL: still in the map
    Column("evidence_sequence", Integer),  # since when it is this thing here; NULL: since its first version
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("feature_class", Text, nullable=False),
    Column("sign", Text),
    Column("value", Text),
    Column("altitude", Double),
    Column("heading_deg", Double),
    Column("existence_confidence", Double, nullable=False),
    Column("position_std_m", Double, nullable=False),
    _point(),
    PrimaryKeyConstraint("feature_id", "from_sequence"),
    CheckConstraint("to_sequence IS NULL OR to_sequence > from_sequence", name="sequence_order"),
)
Index("ix_feature_versions_geom", feature_versions.c.geom, postgresql_using="gist")
Index(
    "ix_feature_versions_current",
    feature_versions.c.map_id,
    feature_versions.c.feature_id,
    unique=True,
    postgresql_where=text("to_sequence IS NULL"),
)

# --- what was reported: the message log, and the passes read out of it -----------------------------------------------

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
    UniqueConstraint("account_id", "session_id", "message_id"),
    CheckConstraint("state IN ('pending', 'fused', 'quarantined')", name="state"),
)
Index("ix_messages_pending", messages.c.id, postgresql_where=text("state = 'pending'"))
Index("ix_messages_region", messages.c.region, messages.c.id, postgresql_where=text("state = 'pending'"))
Index(
    "ix_messages_bodies",
    messages.c.processed_at,
    postgresql_where=text("state = 'fused' AND body IS NOT NULL"),
)
Index("ix_messages_quarantined", messages.c.id, postgresql_where=text("state = 'quarantined'"))

candidates = Table(
    "candidates",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),  # the object id of its watch feature
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("feature_class", Text, nullable=False),
    Column("sign", Text),
    Column("value", Text),
    _point(),
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
    _created(),
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

# --- what is taken out again: the evidence that a retraction names counts nowhere as long as it is active ------------

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
    Column("watch_id", BigInteger, ForeignKey("candidates.id")),  # the watch feature it named
    Column("candidate_id", BigInteger, ForeignKey("candidates.id")),  # the candidate it now counts for
    _point(nullable=True),
    Column("cov_xx", Double),
    Column("cov_xy", Double),
    Column("cov_yy", Double),
    Column("map_sequence", Integer, nullable=False),  # the map version that the vehicle compared with
    Column("sensor_model", Text, nullable=False),
    Column("software_version", Text, nullable=False),
    Column("fleet_id", Text, nullable=False),
    Column("valid", Boolean, nullable=False),  # False: seen, but crossed out or covered: no evidence
    Column("trusted", Boolean, nullable=False),  # the vehicle's own health; untrusted passes are kept, not folded
    Column("archived", Boolean, nullable=False, server_default=text("false")),
    Column("retraction_id", BigInteger, ForeignKey("retractions.id")),  # what has taken it out: kept, not folded
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

# --- what is believed, and what has been said about it ---------------------------------------------------------------

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
    _created(),
)

trust = Table(  # what one version after the other says of contributors; who is not in it is trusted as the policy says
    "trust",
    metadata,
    Column("contributor_id", BigInteger, ForeignKey("accounts.id"), nullable=False),
    Column("from_version", BigInteger, ForeignKey("trust_versions.version"), nullable=False),
    Column("to_version", BigInteger),  # the first version that says otherwise; NULL: the newest says so
    Column("share", Double, nullable=False),  # of the policy's trust
    Column("proven", Boolean, nullable=False),  # has a record
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
    _created(),
)

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
    _point(),
    Column("salt", LargeBinary, nullable=False),  # of this change's pseudonyms
    Column("evidence_left", Boolean, nullable=False, server_default=text("false")),  # since its review
    _created(),
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
    Column("change_id", BigInteger, ForeignKey("changes.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("map_id", BigInteger, ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    Column("revision", Integer, nullable=False),
    Column("kind", Text, nullable=False),
    Column("state", Text, nullable=False),
    Column("document", JSONB, nullable=False),
    _point(),
    _created(),
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
