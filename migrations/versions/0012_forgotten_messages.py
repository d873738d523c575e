"""Of old messages nothing is left but digests, by which a repetition is known"""

import secrets

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "forgotten_messages",
        sa.Column("ids", sa.LargeBinary(), nullable=False),
        sa.Column("content", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("ids", name=op.f("pk_forgotten_messages")),
    )
    forgetting = op.create_table(
        "forgetting",
        sa.Column("id", sa.Boolean(), server_default=sa.text("true"), nullable=False),
        sa.Column("key", sa.LargeBinary(), nullable=False),
        sa.Column("swept_to", sa.BigInteger(), server_default=sa.text("0"), nullable=False),
        sa.Column("swept_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("id", name=op.f("ck_forgetting_single")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_forgetting")),
    )
    op.bulk_insert(forgetting, [{"key": secrets.token_bytes(32)}])


def downgrade() -> None:
    op.drop_table("forgetting")
    op.drop_table("forgotten_messages")
