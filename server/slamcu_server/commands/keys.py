"""Accounts and their keys: create-key, rotate-key, revoke-key, list-keys."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.accounts import repository as account_repository
from slamcu_server.accounts import service as account_service
from slamcu_server.accounts.schemas import IssuedKey, Role
from slamcu_server.commands.common import DataDir, in_transaction, say

_GRACE_MAX_H = 24.0 * 366  # a key that is to go on longer needs no rotation


def register(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.command("create-key")(create_key)
    app.command("rotate-key")(rotate_key)
    app.command("revoke-key")(revoke_key)
    app.command("list-keys")(list_keys)


def create_key(
    role: Annotated[Role | None, typer.Option(help="What its holder may do; needed for a new account.")] = None,
    label: Annotated[str | None, typer.Option(help="Name of the new account, for people.")] = None,
    account: Annotated[str | None, typer.Option(help="Give this existing account another key instead.")] = None,
    count: Annotated[int, typer.Option(min=1, max=100_000, help="Make this many accounts, numbered from 1.")] = 1,
    data_dir: DataDir = None,
) -> None:
    """Make an account with a key, and print the key: it is shown once.

    One vehicle, one account: reports count by account. With --count, prints one line per account: label, tab, key.
    """
    if (role is None) == (account is None):
        raise typer.BadParameter("give --role for a new account, or --account for another key of an existing one")
    if account is not None and (label is not None or count != 1):
        raise typer.BadParameter("--account goes without --label and --count")

    async def work(connection: AsyncConnection) -> list[IssuedKey]:
        if role is None or account is not None:
            return [await account_service.add_key(connection, account or "")]
        if count == 1:
            return [await account_service.create_account(connection, role, label)]
        prefix, width = label or role.value, len(str(count))
        names = [f"{prefix}-{number:0{width}}" for number in range(1, count + 1)]
        return [await account_service.create_account(connection, role, name) for name in names]

    issued = in_transaction(data_dir, work)
    if count == 1:
        typer.echo(issued[0].key)
        say(f"key {issued[0].key_id} of {issued[0].role} account {issued[0].label}; it is not shown again")
        return
    for key in issued:
        typer.echo(f"{key.label}\t{key.key}")


def rotate_key(
    key_id: Annotated[str, typer.Argument(help="The key's id, from list-keys.")],
    grace_hours: Annotated[
        float, typer.Option(min=0, max=_GRACE_MAX_H, help="How long the old key still works.")
    ] = 24.0,
    data_dir: DataDir = None,
) -> None:
    """Give a key's account a new key and let the old one end; the account and its reports stay the same."""
    issued = in_transaction(
        data_dir, lambda connection: account_service.rotate_key(connection, key_id, timedelta(hours=grace_hours))
    )
    typer.echo(issued.key)
    say(f"key {issued.key_id} of {issued.role} account {issued.label}; it is not shown again")


def revoke_key(
    key_id: Annotated[str, typer.Argument(help="The key's id, from list-keys.")], data_dir: DataDir = None
) -> None:
    """End a key for good, within seconds; what its account reported stays."""
    in_transaction(data_dir, lambda connection: account_service.revoke_key(connection, key_id))
    say(f"key {key_id} is revoked; servers that run refuse it within {account_service.CACHE_SECONDS:.0f} s")


def list_keys(data_dir: DataDir = None) -> None:
    """List the keys by account; their secrets are not stored."""
    rows = in_transaction(data_dir, account_repository.list_keys)
    now = datetime.now(UTC)
    table = Table("key id", "role", "account", "made", "state")
    for row in rows:
        table.add_row(row.id, row.role, row.account_label, f"{row.created_at:%Y-%m-%d %H:%M}", _key_state(row, now))
    Console().print(table)


def _key_state(row: Any, now: datetime) -> str:
    if row.revoked_at is not None:
        return f"revoked {row.revoked_at:%Y-%m-%d}"
    if row.expires_at is None:
        return "valid"
    return f"{'ended' if row.expires_at <= now else 'valid until'} {row.expires_at:%Y-%m-%d %H:%M}"
