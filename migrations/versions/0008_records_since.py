"""A record counts from when it was earned"""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("trust", sa.Column("proven_since", sa.DateTime(timezone=True), nullable=True))


def downgrade() -> None:
    op.drop_column("trust", "proven_since")
