"""Kinds of change, fading, and rebase: expand only"""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

_STATES = "'candidate', 'confirmed', 'accepted', 'rejected', 'withdrawn'"


def upgrade() -> None:
    op.add_column("maps", sa.Column("evidence_time", sa.DateTime(timezone=True), nullable=True))
    op.add_column("feature_versions", sa.Column("evidence_sequence", sa.Integer(), nullable=True))
    op.add_column("feature_states", sa.Column("fades_at", sa.DateTime(timezone=True), nullable=True))
    for name in ("forgotten_looked", "forgotten_blocked"):
        op.add_column("feature_states", sa.Column(name, sa.BigInteger(), server_default=sa.text("0"), nullable=False))
    op.add_column("candidates", sa.Column("fades_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("candidates", sa.Column("pair_feature_id", sa.BigInteger(), nullable=True))
    op.add_column("candidates", sa.Column("pair_kind", sa.Text(), nullable=True))
    op.create_foreign_key(op.f("fk_candidates_pair_feature_id"), "candidates", "features", ["pair_feature_id"], ["id"])
    op.create_check_constraint(op.f("ck_candidates_pair_kind"), "candidates", "pair_kind IN ('moved', 'modified')")
    op.create_index(
        "ix_candidates_pair", "candidates", ["pair_feature_id"], postgresql_where=sa.text("pair_feature_id IS NOT NULL")
    )
    op.add_column("changes", sa.Column("first_evidence_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("changes", sa.Column("mapped_at", sa.DateTime(timezone=True), nullable=True))
    op.create_index(
        "ix_changes_open", "changes", ["id"], postgresql_where=sa.text("state IN ('candidate', 'confirmed')")
    )
    op.drop_constraint(op.f("ck_changes_state"), "changes", type_="check")
    op.create_check_constraint(op.f("ck_changes_state"), "changes", f"state IN ({_STATES}, 'absorbed', 'contradicted')")


def downgrade() -> None:
    op.execute("UPDATE changes SET state = 'accepted' WHERE state = 'absorbed'")
    op.execute("UPDATE changes SET state = 'rejected' WHERE state = 'contradicted'")
    op.drop_constraint(op.f("ck_changes_state"), "changes", type_="check")
    op.create_check_constraint(op.f("ck_changes_state"), "changes", f"state IN ({_STATES})")
    op.drop_index("ix_changes_open", table_name="changes")
    op.drop_column("changes", "mapped_at")
    op.drop_column("changes", "first_evidence_at")
    op.drop_index("ix_candidates_pair", table_name="candidates")
    op.drop_constraint(op.f("ck_candidates_pair_kind"), "candidates", type_="check")
    op.drop_constraint(op.f("fk_candidates_pair_feature_id"), "candidates", type_="foreignkey")
    for table, column in (
        ("candidates", "pair_kind"),
        ("candidates", "pair_feature_id"),
        ("candidates", "fades_at"),
        ("feature_states", "forgotten_blocked"),
        ("feature_states", "forgotten_looked"),
        ("feature_states", "fades_at"),
        ("feature_versions", "evidence_sequence"),
        ("maps", "evidence_time"),
    ):
        op.drop_column(table, column)
