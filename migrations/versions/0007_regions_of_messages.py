"""Messages know the region they are from, so that workers can keep out of each other's way"""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("messages", sa.Column("region", sa.BigInteger(), server_default=sa.text("0"), nullable=False))
    op.create_index("ix_messages_region", "messages", ["region", "id"], postgresql_where=sa.text("state = 'pending'"))


def downgrade() -> None:
    op.drop_index("ix_messages_region", "messages")
    op.drop_column("messages", "region")
