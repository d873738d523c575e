"""Work that failed for a lasting reason is put aside, with the reason, and tried again later"""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "put_aside",
        sa.Column("work", sa.Text(), nullable=False),
        sa.Column("key", sa.BigInteger(), nullable=False),
        sa.Column("error", sa.Text(), nullable=False),
        sa.Column("attempts", sa.Integer(), server_default=sa.text("1"), nullable=False),
        sa.Column("failed_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("retry_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("work IN ('retraction', 'correction', 'fading')", name=op.f("ck_put_aside_work")),
        sa.PrimaryKeyConstraint("work", "key", name=op.f("pk_put_aside")),
    )


def downgrade() -> None:
    op.drop_table("put_aside")
