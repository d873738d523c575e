"""Retractions: evidence that is taken out again"""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "retractions",
        sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("state", sa.Text(), server_default="requested", nullable=False),
        sa.Column("contributor_id", sa.BigInteger(), nullable=True),
        sa.Column("session_id", sa.Text(), nullable=True),
        sa.Column("fleet_id", sa.Text(), nullable=True),
        sa.Column("software_version", sa.Text(), nullable=True),
        sa.Column("event_from", sa.DateTime(timezone=True), nullable=True),
        sa.Column("event_until", sa.DateTime(timezone=True), nullable=True),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("requested_by", sa.BigInteger(), nullable=True),
        sa.Column("requested_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("applied_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("passes", sa.BigInteger(), nullable=True),
        sa.Column("features", sa.BigInteger(), nullable=True),
        sa.Column("candidates", sa.BigInteger(), nullable=True),
        sa.Column("undo_reason", sa.Text(), nullable=True),
        sa.Column("undone_by", sa.BigInteger(), nullable=True),
        sa.Column("undo_requested_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("undone_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "state IN ('requested', 'applying', 'applied', 'undo_requested', 'undoing', 'undone')",
            name=op.f("ck_retractions_state"),
        ),
        sa.CheckConstraint(
            "num_nonnulls(contributor_id, session_id, fleet_id, software_version, event_from, event_until) > 0",
            name=op.f("ck_retractions_names_something"),
        ),
        sa.ForeignKeyConstraint(["contributor_id"], ["accounts.id"], name=op.f("fk_retractions_contributor_id")),
        sa.ForeignKeyConstraint(["requested_by"], ["accounts.id"], name=op.f("fk_retractions_requested_by")),
        sa.ForeignKeyConstraint(["undone_by"], ["accounts.id"], name=op.f("fk_retractions_undone_by")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_retractions")),
    )
    op.create_index(
        "ix_retractions_active",
        "retractions",
        ["contributor_id"],
        postgresql_where=sa.text("state IN ('requested', 'applying', 'applied')"),
    )
    op.create_table(
        "corrections",
        sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("pass_id", sa.BigInteger(), nullable=False),
        sa.Column("retraction_id", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["retraction_id"], ["retractions.id"], name=op.f("fk_corrections_retraction_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_corrections")),
    )
    op.create_index("ix_corrections_retraction_id", "corrections", ["retraction_id"])
    op.add_column("passes", sa.Column("retraction_id", sa.BigInteger(), nullable=True))
    op.create_foreign_key(op.f("fk_passes_retraction_id"), "passes", "retractions", ["retraction_id"], ["id"])
    op.create_index(
        "ix_passes_retraction", "passes", ["retraction_id"], postgresql_where=sa.text("retraction_id IS NOT NULL")
    )


def downgrade() -> None:
    op.drop_index("ix_passes_retraction", table_name="passes")
    op.drop_constraint(op.f("fk_passes_retraction_id"), "passes", type_="foreignkey")
    op.drop_column("passes", "retraction_id")
    op.drop_table("corrections")
    op.drop_table("retractions")
