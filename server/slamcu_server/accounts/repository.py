"""Accounts and keys in the database."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import Row, func, insert, select, update
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.accounts.schemas import MapScope, Principal, Role, StoredKey
from slamcu_server.database.tables import accounts, api_keys, maps


async def find_account(connection: AsyncConnection, label: str) -> tuple[int, Role] | None:
    """Return id and role of the account with `label`."""
    query = select(accounts.c.id, accounts.c.role).where(accounts.c.label == label)
    row = (await connection.execute(query)).one_or_none()
    return (row.id, Role(row.role)) if row else None


async def add_account(connection: AsyncConnection, role: Role, label: str, scope: MapScope) -> int:
    """Add an account; raises IntegrityError if the label is taken."""
    query = insert(accounts).values(role=role.value, label=label, maps=scope.names()).returning(accounts.c.id)
    return int((await connection.execute(query)).scalar_one())


async def bind_account(connection: AsyncConnection, account_id: int, scope: MapScope) -> None:
    """Bind an account to maps, in place of those it was bound to."""
    await connection.execute(update(accounts).where(accounts.c.id == account_id).values(maps=scope.names()))


async def absent_maps(connection: AsyncConnection, scope: MapScope) -> list[str]:
    """Return the names in a scope that no map has."""
    names = scope.names() or []
    here = set((await connection.execute(select(maps.c.source).where(maps.c.source.in_(names)))).scalars())
    return [name for name in names if name not in here]


async def add_key(
    connection: AsyncConnection, account_id: int, key_id: str, secret_sha256: bytes, expires_at: datetime | None
) -> None:
    """Add a key of an account."""
    values = {"id": key_id, "account_id": account_id, "secret_sha256": secret_sha256, "expires_at": expires_at}
    await connection.execute(insert(api_keys).values(values))


async def find_key(connection: AsyncConnection, key_id: str) -> StoredKey | None:
    """Return the key with `key_id`, whether it is still valid or not."""
    query = (
        select(
            api_keys.c.secret_sha256,
            api_keys.c.expires_at,
            api_keys.c.revoked_at,
            accounts.c.id.label("account_id"),
            accounts.c.role,
            accounts.c.label.label("account_label"),
            accounts.c.maps,
        )
        .join_from(api_keys, accounts)
        .where(api_keys.c.id == key_id)
    )
    row = (await connection.execute(query)).one_or_none()
    if row is None:
        return None
    scope = MapScope(None if row.maps is None else frozenset(row.maps))
    principal = Principal(row.account_id, Role(row.role), row.account_label, key_id, scope)
    return StoredKey(principal, row.secret_sha256, row.expires_at, row.revoked_at)


async def end_key(connection: AsyncConnection, key_id: str, at: datetime) -> None:
    """Let a key expire at `at`, or earlier if it would anyway."""
    # LEAST ignores NULL: a key without an end gets this one.
    query = update(api_keys).where(api_keys.c.id == key_id).values(expires_at=func.least(api_keys.c.expires_at, at))
    await connection.execute(query)


async def revoke_key(connection: AsyncConnection, key_id: str) -> bool:
    """Revoke a key; return whether there was one to revoke. Revoking twice keeps the first time."""
    revoked_at = func.coalesce(api_keys.c.revoked_at, func.now())
    query = update(api_keys).where(api_keys.c.id == key_id).values(revoked_at=revoked_at)
    return (await connection.execute(query)).rowcount == 1


async def list_keys(connection: AsyncConnection) -> list[Row[Any]]:
    """Return every key with its account, oldest first."""
    query = (
        select(
            api_keys.c.id,
            accounts.c.role,
            accounts.c.label.label("account_label"),
            accounts.c.maps,
            api_keys.c.created_at,
            api_keys.c.expires_at,
            api_keys.c.revoked_at,
        )
        .join_from(api_keys, accounts)
        .order_by(accounts.c.id, api_keys.c.created_at, api_keys.c.id)
    )
    return list(await connection.execute(query))
