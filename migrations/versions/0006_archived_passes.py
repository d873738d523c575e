"""Archived passes can be found, to be forgotten in time"""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index("ix_passes_archived", "passes", ["id"], postgresql_where=sa.text("archived"))


def downgrade() -> None:
    op.drop_index("ix_passes_archived", table_name="passes")
