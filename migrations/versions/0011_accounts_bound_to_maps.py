"""An account may be bound to maps: another provider's are none to it"""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("accounts", sa.Column("maps", sa.ARRAY(sa.Text()), nullable=True))
    op.create_check_constraint(op.f("ck_accounts_maps"), "accounts", "maps IS NULL OR role <> 'admin'")


def downgrade() -> None:
    op.drop_constraint(op.f("ck_accounts_maps"), "accounts")
    op.drop_column("accounts", "maps")
