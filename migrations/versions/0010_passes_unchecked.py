"""Passes are stored without checking anything that they name again; the index that no claim reads any more goes"""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None

_UNCHECKED = {"watch_id": "candidates", "candidate_id": "candidates", "retraction_id": "retractions"}


def upgrade() -> None:
    for column in _UNCHECKED:
        op.drop_constraint(op.f(f"fk_passes_{column}"), "passes")
    op.drop_index("ix_messages_region", "messages")


def downgrade() -> None:
    op.create_index("ix_messages_region", "messages", ["region", "id"], postgresql_where=sa.text("state = 'pending'"))
    for column, table in _UNCHECKED.items():
        op.create_foreign_key(op.f(f"fk_passes_{column}"), "passes", table, [column], ["id"])
