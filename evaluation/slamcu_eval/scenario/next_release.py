"""The next release of the server, as far as an upgrade is concerned: this code with one more migration."""

from __future__ import annotations

import shutil
from pathlib import Path

import slamcu_server
from slamcu_server.database import migrate

_MIGRATION = '''"""What a next release might add: a column, an index, a table. Only additions, as all migrations."""

import sqlalchemy as sa
from alembic import op

revision = "{revision}"
down_revision = "{head}"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("messages", sa.Column("next_release_note", sa.Text(), server_default="none yet", nullable=False))
    op.create_index("ix_messages_next_release", "messages", ["received_at"])
    op.create_table("next_release", sa.Column("id", sa.BigInteger(), sa.Identity(), primary_key=True))


def downgrade() -> None:
    op.drop_table("next_release")
    op.drop_index("ix_messages_next_release")
    op.drop_column("messages", "next_release_note")
'''


def revision() -> str:
    """Return the schema's revision of the next release."""
    return f"{int(migrate.head()) + 1:04}"


def migration() -> tuple[str, str]:
    """Return the name of the migration's file, and its text."""
    return f"{revision()}_next_release.py", _MIGRATION.format(revision=revision(), head=migrate.head())


def make_package(folder: Path) -> Path:
    """Write the server's package of the next release into a folder, for PYTHONPATH, and return the folder."""
    package = folder / "slamcu_server"
    ignore = shutil.ignore_patterns("__pycache__", "migrations")
    shutil.copytree(Path(slamcu_server.__file__).parent, package, ignore=ignore)
    shutil.copytree(migrate.migrations_dir(), package / "migrations", ignore=shutil.ignore_patterns("__pycache__"))
    name, text = migration()
    (package / "migrations" / "versions" / name).write_text(text, encoding="utf-8")
    return folder
