"""Messages wait in the log as the ingest has read them: nobody reads them twice"""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("messages", sa.Column("condensed", sa.LargeBinary(), nullable=True))
    op.execute("""
        DO $$ BEGIN
            ALTER TABLE messages ALTER COLUMN condensed SET COMPRESSION lz4;
        EXCEPTION WHEN feature_not_supported THEN NULL;
        END $$""")


def downgrade() -> None:
    op.drop_column("messages", "condensed")
