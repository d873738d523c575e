"""The tables of the spine"""

import sqlalchemy as sa
from alembic import op
from geoalchemy2 import Geometry
from sqlalchemy.dialects.postgresql import JSONB

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def point() -> Geometry:
    # A new one for each column: GeoAlchemy2 binds a type to the column that it is first used in.
    return Geometry("POINT", srid=4326, spatial_index=False)


def upgrade() -> None:
    op.execute("CREATE EXTENSION IF NOT EXISTS postgis")
    op.create_table(
        "accounts",
        sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("role", sa.Text(), nullable=False),
        sa.Column("label", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("role IN ('vehicle', 'provider', 'admin')", name=op.f("ck_accounts_role")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_accounts")),
        sa.UniqueConstraint("label", name=op.f("uq_accounts_label")),
    )
    op.create_table(
        "feed_position",
        sa.Column("id", sa.Boolean(), server_default=sa.text("true"), nullable=False),
        sa.Column("last_sequence", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("id", name=op.f("ck_feed_position_one_row")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_feed_position")),
    )
    op.create_table(
        "maps",
        sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("source", sa.Text(), nullable=False),
        sa.Column("current_sequence", sa.Integer(), nullable=False),
        sa.Column("next_object_id", sa.BigInteger(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_maps")),
        sa.UniqueConstraint("source", name=op.f("uq_maps_source")),
    )
    op.create_table(
        "policies",
        sa.Column("version", sa.Text(), nullable=False),
        sa.Column("document", JSONB(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.PrimaryKeyConstraint("version", name=op.f("pk_policies")),
    )
    op.create_table(
        "api_keys",
        sa.Column("id", sa.Text(), nullable=False),
        sa.Column("account_id", sa.BigInteger(), nullable=False),
        sa.Column("secret_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["account_id"], ["accounts.id"], name=op.f("fk_api_keys_account_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_api_keys")),
    )
    op.create_index(op.f("ix_api_keys_account_id"), "api_keys", ["account_id"])
    op.create_table(
        "features",
        sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("map_id", sa.BigInteger(), nullable=False),
        sa.Column("object_id", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_features_map_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_features")),
        sa.UniqueConstraint("map_id", "object_id", name=op.f("uq_features_map_id_object_id")),
    )
    op.create_table(
        "map_versions",
        sa.Column("map_id", sa.BigInteger(), nullable=False),
        sa.Column("sequence", sa.Integer(), nullable=False),
        sa.Column("version", sa.Text(), nullable=False),
        sa.Column("origin", sa.Text(), nullable=False),
        sa.Column("change_id", sa.BigInteger(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("origin IN ('import', 'review')", name=op.f("ck_map_versions_origin")),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_map_versions_map_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("map_id", "sequence", name=op.f("pk_map_versions")),
        sa.UniqueConstraint("map_id", "version", name=op.f("uq_map_versions_map_id_version")),
    )
    op.create_table(
        "messages",
        sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("account_id", sa.BigInteger(), nullable=False),
        sa.Column("session_id", sa.Text(), nullable=False),
        sa.Column("message_id", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.LargeBinary(), nullable=False),
        sa.Column("body", sa.LargeBinary(), nullable=True),
        sa.Column("received_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("state", sa.Text(), server_default="pending", nullable=False),
        sa.Column("processed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("error", sa.Text(), nullable=True),
        sa.CheckConstraint("state IN ('pending', 'fused', 'quarantined')", name=op.f("ck_messages_state")),
        sa.ForeignKeyConstraint(["account_id"], ["accounts.id"], name=op.f("fk_messages_account_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_messages")),
        sa.UniqueConstraint(
            "account_id", "session_id", "message_id", name=op.f("uq_messages_account_id_session_id_message_id")
        ),
    )
    op.create_index("ix_messages_pending", "messages", ["id"], postgresql_where=sa.text("state = 'pending'"))
    op.create_index(
        "ix_messages_bodies",
        "messages",
        ["processed_at"],
        postgresql_where=sa.text("state = 'fused' AND body IS NOT NULL"),
    )
    op.create_index("ix_messages_quarantined", "messages", ["id"], postgresql_where=sa.text("state = 'quarantined'"))
    op.create_table(
        "candidates",
        sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("map_id", sa.BigInteger(), nullable=False),
        sa.Column("feature_class", sa.Text(), nullable=False),
        sa.Column("sign", sa.Text(), nullable=True),
        sa.Column("value", sa.Text(), nullable=True),
        sa.Column("geom", point(), nullable=False),
        sa.Column("cov_xx", sa.Double(), nullable=False),
        sa.Column("cov_xy", sa.Double(), nullable=False),
        sa.Column("cov_yy", sa.Double(), nullable=False),
        sa.Column("weight_for", sa.Double(), nullable=False),
        sa.Column("weight_against", sa.Double(), nullable=False),
        sa.Column("standing", sa.Boolean(), nullable=False),
        sa.Column("contributors_for", sa.Integer(), nullable=False),
        sa.Column("contributors_against", sa.Integer(), nullable=False),
        sa.Column("passes", sa.Integer(), nullable=False),
        sa.Column("first_seen", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_seen", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_looked", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_informative", sa.DateTime(timezone=True), nullable=True),
        sa.Column("founding_pass", sa.BigInteger(), nullable=False),
        sa.Column("merged_into", sa.BigInteger(), nullable=True),
        sa.Column("feature_id", sa.BigInteger(), nullable=True),
        sa.Column("policy_version", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.ForeignKeyConstraint(["feature_id"], ["features.id"], name=op.f("fk_candidates_feature_id")),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_candidates_map_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["merged_into"], ["candidates.id"], name=op.f("fk_candidates_merged_into")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_candidates")),
        sa.UniqueConstraint("founding_pass", name=op.f("uq_candidates_founding_pass")),
    )
    op.create_index(
        "ix_candidates_geom",
        "candidates",
        ["geom"],
        postgresql_using="gist",
        postgresql_where=sa.text("merged_into IS NULL AND feature_id IS NULL"),
    )
    op.create_table(
        "feature_states",
        sa.Column("feature_id", sa.BigInteger(), nullable=False),
        sa.Column("weight_for", sa.Double(), nullable=False),
        sa.Column("weight_against", sa.Double(), nullable=False),
        sa.Column("standing", sa.Boolean(), nullable=False),
        sa.Column("contributors_for", sa.Integer(), nullable=False),
        sa.Column("contributors_against", sa.Integer(), nullable=False),
        sa.Column("passes", sa.Integer(), nullable=False),
        sa.Column("looked", sa.BigInteger(), nullable=False),
        sa.Column("blocked", sa.BigInteger(), nullable=False),
        sa.Column("last_looked", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_seen", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_informative", sa.DateTime(timezone=True), nullable=True),
        sa.Column("policy_version", sa.Text(), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.ForeignKeyConstraint(
            ["feature_id"], ["features.id"], name=op.f("fk_feature_states_feature_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("feature_id", name=op.f("pk_feature_states")),
    )
    op.create_table(
        "feature_versions",
        sa.Column("feature_id", sa.BigInteger(), nullable=False),
        sa.Column("from_sequence", sa.Integer(), nullable=False),
        sa.Column("to_sequence", sa.Integer(), nullable=True),
        sa.Column("map_id", sa.BigInteger(), nullable=False),
        sa.Column("feature_class", sa.Text(), nullable=False),
        sa.Column("sign", sa.Text(), nullable=True),
        sa.Column("value", sa.Text(), nullable=True),
        sa.Column("altitude", sa.Double(), nullable=True),
        sa.Column("heading_deg", sa.Double(), nullable=True),
        sa.Column("existence_confidence", sa.Double(), nullable=False),
        sa.Column("position_std_m", sa.Double(), nullable=False),
        sa.Column("geom", point(), nullable=False),
        sa.CheckConstraint(
            "to_sequence IS NULL OR to_sequence > from_sequence", name=op.f("ck_feature_versions_sequence_order")
        ),
        sa.ForeignKeyConstraint(
            ["feature_id"], ["features.id"], name=op.f("fk_feature_versions_feature_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_feature_versions_map_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("feature_id", "from_sequence", name=op.f("pk_feature_versions")),
    )
    op.create_index(
        "ix_feature_versions_current",
        "feature_versions",
        ["map_id", "feature_id"],
        unique=True,
        postgresql_where=sa.text("to_sequence IS NULL"),
    )
    op.create_index("ix_feature_versions_geom", "feature_versions", ["geom"], postgresql_using="gist")
    op.create_table(
        "changes",
        sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("map_id", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("feature_id", sa.BigInteger(), nullable=True),
        sa.Column("candidate_id", sa.BigInteger(), nullable=True),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("document", JSONB(), nullable=False),
        sa.Column("geom", point(), nullable=False),
        sa.Column("salt", sa.LargeBinary(), nullable=False),
        sa.Column("evidence_left", sa.Boolean(), server_default=sa.text("false"), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("kind IN ('new', 'deleted', 'moved', 'modified')", name=op.f("ck_changes_kind")),
        sa.CheckConstraint(
            "state IN ('candidate', 'confirmed', 'accepted', 'rejected', 'withdrawn')", name=op.f("ck_changes_state")
        ),
        sa.ForeignKeyConstraint(["candidate_id"], ["candidates.id"], name=op.f("fk_changes_candidate_id")),
        sa.ForeignKeyConstraint(["feature_id"], ["features.id"], name=op.f("fk_changes_feature_id")),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_changes_map_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_changes")),
    )
    op.create_index("ix_changes_candidate", "changes", ["candidate_id"])
    op.create_index("ix_changes_feature", "changes", ["feature_id"])
    op.create_index("ix_changes_geom", "changes", ["geom"], postgresql_using="gist")
    op.create_table(
        "passes",
        sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("message", sa.BigInteger(), nullable=False),
        sa.Column("index_in_message", sa.Integer(), nullable=False),
        sa.Column("map_id", sa.BigInteger(), nullable=False),
        sa.Column("contributor_id", sa.BigInteger(), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("ended_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("status", sa.Text(), nullable=False),
        sa.Column("feature_class", sa.Text(), nullable=False),
        sa.Column("sign", sa.Text(), nullable=True),
        sa.Column("value", sa.Text(), nullable=True),
        sa.Column("weight_for", sa.Double(), nullable=False),
        sa.Column("weight_against", sa.Double(), nullable=False),
        sa.Column("frames_detected", sa.Integer(), nullable=False),
        sa.Column("frames_missed", sa.Integer(), nullable=False),
        sa.Column("frames_blocked", sa.Integer(), nullable=False),
        sa.Column("feature_id", sa.BigInteger(), nullable=True),
        sa.Column("watch_id", sa.BigInteger(), nullable=True),
        sa.Column("candidate_id", sa.BigInteger(), nullable=True),
        sa.Column("geom", point(), nullable=True),
        sa.Column("cov_xx", sa.Double(), nullable=True),
        sa.Column("cov_xy", sa.Double(), nullable=True),
        sa.Column("cov_yy", sa.Double(), nullable=True),
        sa.Column("map_sequence", sa.Integer(), nullable=False),
        sa.Column("sensor_model", sa.Text(), nullable=False),
        sa.Column("software_version", sa.Text(), nullable=False),
        sa.Column("fleet_id", sa.Text(), nullable=False),
        sa.Column("valid", sa.Boolean(), nullable=False),
        sa.Column("trusted", sa.Boolean(), nullable=False),
        sa.Column("archived", sa.Boolean(), server_default=sa.text("false"), nullable=False),
        sa.ForeignKeyConstraint(["candidate_id"], ["candidates.id"], name=op.f("fk_passes_candidate_id")),
        sa.ForeignKeyConstraint(["contributor_id"], ["accounts.id"], name=op.f("fk_passes_contributor_id")),
        sa.ForeignKeyConstraint(["feature_id"], ["features.id"], name=op.f("fk_passes_feature_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_passes_map_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["message"], ["messages.id"], name=op.f("fk_passes_message")),
        sa.ForeignKeyConstraint(["watch_id"], ["candidates.id"], name=op.f("fk_passes_watch_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_passes")),
        sa.UniqueConstraint("message", "index_in_message", name=op.f("uq_passes_message_index_in_message")),
    )
    op.create_index(
        "ix_passes_candidate", "passes", ["candidate_id"], postgresql_where=sa.text("candidate_id IS NOT NULL")
    )
    op.create_index(
        "ix_passes_feature", "passes", ["feature_id", "ended_at"], postgresql_where=sa.text("feature_id IS NOT NULL")
    )
    op.create_index(
        "ix_passes_unreferenced_geom",
        "passes",
        ["geom"],
        postgresql_using="gist",
        postgresql_where=sa.text("feature_id IS NULL AND watch_id IS NULL AND NOT archived"),
    )
    op.create_index("ix_passes_watch", "passes", ["watch_id"], postgresql_where=sa.text("watch_id IS NOT NULL"))
    op.create_table(
        "change_entries",
        sa.Column("sequence", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("change_id", sa.BigInteger(), nullable=False),
        sa.Column("map_id", sa.BigInteger(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("document", JSONB(), nullable=False),
        sa.Column("geom", point(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.ForeignKeyConstraint(
            ["change_id"], ["changes.id"], name=op.f("fk_change_entries_change_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_change_entries_map_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("sequence", name=op.f("pk_change_entries")),
        sa.UniqueConstraint("change_id", "revision", name=op.f("uq_change_entries_change_id_revision")),
    )
    op.create_index(op.f("ix_change_entries_change_id"), "change_entries", ["change_id"])
    op.create_index("ix_change_entries_geom", "change_entries", ["geom"], postgresql_using="gist")
    op.execute("INSERT INTO feed_position (last_sequence) VALUES (0)")


def downgrade() -> None:
    # The extension stays: others may use it, and it may not have been ours to make.
    op.drop_table("change_entries")
    op.drop_table("passes")
    op.drop_table("changes")
    op.drop_table("feature_versions")
    op.drop_table("feature_states")
    op.drop_table("candidates")
    op.drop_table("messages")
    op.drop_table("map_versions")
    op.drop_table("features")
    op.drop_table("api_keys")
    op.drop_table("policies")
    op.drop_table("maps")
    op.drop_table("feed_position")
    op.drop_table("accounts")
