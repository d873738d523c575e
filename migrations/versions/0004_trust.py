"""Trust: what is made of the contributors' records, in versions"""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "trust_versions",
        sa.Column("version", sa.BigInteger(), sa.Identity(), nullable=False),
        sa.Column("judged", sa.BigInteger(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.PrimaryKeyConstraint("version", name=op.f("pk_trust_versions")),
    )
    op.create_table(
        "trust",
        sa.Column("contributor_id", sa.BigInteger(), nullable=False),
        sa.Column("from_version", sa.BigInteger(), nullable=False),
        sa.Column("to_version", sa.BigInteger(), nullable=True),
        sa.Column("share", sa.Double(), nullable=False),
        sa.Column("proven", sa.Boolean(), nullable=False),
        sa.Column("right_count", sa.Integer(), nullable=False),
        sa.Column("wrong_count", sa.Integer(), nullable=False),
        sa.Column("right_claims", sa.Integer(), nullable=False),
        sa.Column("wrong_claims", sa.Integer(), nullable=False),
        sa.CheckConstraint("share BETWEEN 0 AND 1", name=op.f("ck_trust_share")),
        sa.ForeignKeyConstraint(["contributor_id"], ["accounts.id"], name=op.f("fk_trust_contributor_id")),
        sa.ForeignKeyConstraint(["from_version"], ["trust_versions.version"], name=op.f("fk_trust_from_version")),
        sa.PrimaryKeyConstraint("contributor_id", "from_version", name=op.f("pk_trust")),
    )
    op.create_index(
        "ix_trust_current", "trust", ["contributor_id"], unique=True, postgresql_where=sa.text("to_version IS NULL")
    )


def downgrade() -> None:
    op.drop_table("trust")
    op.drop_table("trust_versions")
