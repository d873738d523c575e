"""Who: an account outlives its keys; a vehicle's account is one contributor."""

from __future__ import annotations

from sqlalchemy import (
    ARRAY,
    BigInteger,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Identity,
    LargeBinary,
    Table,
    Text,
)

from slamcu_server.database.tables.columns import created, metadata

accounts = Table(
    "accounts",
    metadata,
    Column("id", BigInteger, Identity(), primary_key=True),
    Column("role", Text, nullable=False),
    Column("label", Text, nullable=False, unique=True),
    Column("maps", ARRAY(Text)),  # names of those that it is bound to; null: it has to do with all
    created(),
    CheckConstraint("role IN ('vehicle', 'provider', 'admin')", name="role"),
    CheckConstraint("maps IS NULL OR role <> 'admin'", name="maps"),
)

api_keys = Table(
    "api_keys",
    metadata,
    Column("id", Text, primary_key=True),  # the public part of the key
    Column("account_id", BigInteger, ForeignKey("accounts.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("secret_sha256", LargeBinary, nullable=False),
    created(),
    Column("expires_at", DateTime(timezone=True)),
    Column("revoked_at", DateTime(timezone=True)),
)
