"""Map features carry the passes that they are folded from; passes are stored without checking what they name again"""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

_UNCHECKED = {"message": "messages", "map_id": "maps", "contributor_id": "accounts", "feature_id": "features"}


def upgrade() -> None:
    op.add_column("feature_states", sa.Column("passes_window", sa.LargeBinary(), nullable=True))
    op.add_column("feature_states", sa.Column("window_at", sa.DateTime(timezone=True), nullable=True))
    # Windows stay in their rows (2 kB when they are full) as they are, and are overwritten in the same page.
    op.execute("ALTER TABLE feature_states ALTER COLUMN passes_window SET STORAGE EXTERNAL")
    op.execute("ALTER TABLE feature_states SET (fillfactor = 70, toast_tuple_target = 8160)")
    for column in _UNCHECKED:
        op.drop_constraint(op.f(f"fk_passes_{column}"), "passes")
    op.execute("""
        DO $$ BEGIN
            ALTER TABLE messages ALTER COLUMN body SET COMPRESSION lz4;
        EXCEPTION WHEN feature_not_supported THEN NULL;
        END $$""")


def downgrade() -> None:
    op.execute("ALTER TABLE messages ALTER COLUMN body SET COMPRESSION default")
    for column, table in _UNCHECKED.items():
        op.create_foreign_key(
            op.f(f"fk_passes_{column}"),
            "passes",
            table,
            [column],
            ["id"],
            ondelete="CASCADE" if column in ("map_id", "feature_id") else None,
        )
    op.execute("ALTER TABLE feature_states RESET (fillfactor, toast_tuple_target)")
    op.drop_column("feature_states", "window_at")
    op.drop_column("feature_states", "passes_window")
