"""The entries of a change are found by the index that keeps its revisions apart: the other one was only written"""

from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.drop_index(op.f("ix_change_entries_change_id"), table_name="change_entries")


def downgrade() -> None:
    op.create_index(op.f("ix_change_entries_change_id"), "change_entries", ["change_id"])
