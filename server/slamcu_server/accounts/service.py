"""Issue, rotate, revoke and check keys."""

from __future__ import annotations

import secrets
import time
from collections import OrderedDict
from datetime import UTC, datetime, timedelta

from sqlalchemy.exc import IntegrityError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.errors import SlamcuError
from slamcu_server.accounts import keys, repository
from slamcu_server.accounts.schemas import ALL_MAPS, IssuedKey, MapScope, Principal, Role, StoredKey

CACHE_SECONDS = 5.0  # how long a revoked key may go on working
_CACHE_SIZE = 10_000
_LABEL_MAX = 200


class AccountError(SlamcuError):
    """An account or key cannot be made, found or changed as asked."""


async def create_account(
    connection: AsyncConnection, role: Role, label: str | None = None, scope: MapScope = ALL_MAPS
) -> IssuedKey:
    """Make an account with its first key, bound to maps if they are given; these need not be there yet.

    Raises AccountError if the label is taken or cannot be used, or if the role is bound to nothing.
    """
    _require_binding(role, scope)
    label = f"{role.value}-{secrets.token_hex(4)}" if label is None else label.strip()
    if not 0 < len(label) <= _LABEL_MAX or not label.isprintable():
        raise AccountError(f"a label has 1 to {_LABEL_MAX} printable characters")
    try:
        async with connection.begin_nested():
            account_id = await repository.add_account(connection, role, label, scope)
    except IntegrityError:
        raise AccountError(f"there is an account {label!r} already: --account {label} gives it another key") from None
    return await _issue(connection, account_id, role, label)


async def add_key(connection: AsyncConnection, label: str) -> IssuedKey:
    """Give an existing account another key. Raises AccountError if there is no such account."""
    return await _issue(connection, *await _account(connection, label), label)


async def bind_account(connection: AsyncConnection, label: str, scope: MapScope) -> None:
    """Bind an account with all its keys to maps, in place of those it was bound to.

    Raises AccountError if there is no such account, or if its role is bound to nothing.
    """
    account_id, role = await _account(connection, label)
    _require_binding(role, scope)
    await repository.bind_account(connection, account_id, scope)


async def _account(connection: AsyncConnection, label: str) -> tuple[int, Role]:
    found = await repository.find_account(connection, label)
    if found is None:
        raise AccountError(f"there is no account {label!r}")
    return found


def _require_binding(role: Role, scope: MapScope) -> None:
    if scope.sources is not None and role is Role.ADMIN:
        raise AccountError("an admin's account is bound to no map: its keys may do all")
    if not all(source and source.isprintable() for source in scope.sources or ()):
        raise AccountError("a map's name has one printable character at least")


async def rotate_key(connection: AsyncConnection, key_id: str, grace: timedelta) -> IssuedKey:
    """Give a key's account a new key; the old one works for `grace` more. Raises AccountError if it is not valid."""
    stored = await repository.find_key(connection, key_id)
    now = datetime.now(UTC)
    if stored is None or not stored.valid_at(now):
        raise AccountError(f"there is no valid key {key_id!r}")
    await repository.end_key(connection, key_id, now + grace)
    holder = stored.principal
    return await _issue(connection, holder.account_id, holder.role, holder.label)


async def revoke_key(connection: AsyncConnection, key_id: str) -> None:
    """Revoke a key for good; its account and what it reported stay. Raises AccountError if there is no such key."""
    if not await repository.revoke_key(connection, key_id):
        raise AccountError(f"there is no key {key_id!r}; list-keys shows their ids")


async def _issue(connection: AsyncConnection, account_id: int, role: Role, label: str) -> IssuedKey:
    key, key_id, secret_sha256 = keys.generate()
    await repository.add_key(connection, account_id, key_id, secret_sha256, None)
    return IssuedKey(key, key_id, role, label)


class Authenticator:
    """Tell whose key it is, asking the database at most every `CACHE_SECONDS` per key."""

    def __init__(self, engine: AsyncEngine) -> None:
        self._engine = engine
        self._cache: OrderedDict[str, tuple[float, StoredKey]] = OrderedDict()

    async def authenticate(self, key: str) -> Principal | None:
        """Return who holds `key`; None if it is unknown, wrong, expired or revoked."""
        parsed = keys.parse(key)
        if parsed is None:
            return None
        key_id, secret = parsed
        stored = await self._find(key_id)
        if stored is None or not keys.matches(secret, stored.secret_sha256) or not stored.valid_at(datetime.now(UTC)):
            return None
        return stored.principal

    async def _find(self, key_id: str) -> StoredKey | None:
        fresh_from = time.monotonic() - CACHE_SECONDS
        if (cached := self._cache.get(key_id)) and cached[0] > fresh_from:
            return cached[1]
        async with self._engine.connect() as connection:
            stored = await repository.find_key(connection, key_id)
        self._cache.pop(key_id, None)  # so that it comes last
        if stored is not None:
            self._cache[key_id] = (time.monotonic(), stored)
            while len(self._cache) > _CACHE_SIZE:
                self._cache.popitem(last=False)
        return stored
