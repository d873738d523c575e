"""Accounts and their keys: create-key, bind-account, rotate-key, revoke-key, list-keys."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.accounts import repository as account_repository
from slamcu_server.accounts import service as account_service
from slamcu_server.accounts.schemas import ALL_MAPS, IssuedKey, MapScope, Role
from slamcu_server.commands.common import DataDir, in_transaction, say

_Maps = Annotated[
    list[str], typer.Option("--map", metavar="NAME", help="Bind the account to this map; may be given several times.")
]
_GRACE_MAX_H = 24.0 * 366  # a key that is to go on longer needs no rotation


def register(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.command("create-key")(create_key)
    app.command("bind-account")(bind_account)
    app.command("rotate-key")(rotate_key)
    app.command("revoke-key")(revoke_key)
    app.command("list-keys")(list_keys)


def create_key(
    *,
    role: Annotated[Role | None, typer.Option(help="What its holder may do; needed for a new account.")] = None,
    label: Annotated[str | None, typer.Option(help="Name of the new account, for people.")] = None,
    account: Annotated[str | None, typer.Option(help="Give this existing account another key instead.")] = None,
    count: Annotated[int, typer.Option(min=1, max=100_000, help="Make this many accounts, numbered from 1.")] = 1,
    maps: _Maps = [],  # noqa: B006
    data_dir: DataDir = None,
) -> None:
    """Make an account with a key, and print the key: it is shown once.

    One vehicle, one account: reports count by account. With --count, prints one line per account: label, tab, key.
    An account that is bound to maps reads, reviews and reports about these only; the others are none to it.
    """
    if (role is None) == (account is None):
        raise typer.BadParameter("give --role for a new account, or --account for another key of an existing one")
    if account is not None and (label is not None or count != 1 or maps):
        raise typer.BadParameter("--account goes without --label, --count and --map; bind-account binds it")
    scope = MapScope(frozenset(maps)) if maps else ALL_MAPS

    async def work(connection: AsyncConnection) -> tuple[list[IssuedKey], list[str]]:
        if role is None or account is not None:
            return [await account_service.add_key(connection, account or "")], []
        names = [label]
        if count > 1:
            prefix, width = label or role.value, len(str(count))
            names = [f"{prefix}-{number:0{width}}" for number in range(1, count + 1)]
        made = [await account_service.create_account(connection, role, name, scope) for name in names]
        return made, await account_repository.absent_maps(connection, scope)

    issued, absent = in_transaction(data_dir, work)
    _warn_of(absent)
    if count == 1:
        typer.echo(issued[0].key)
        say(f"key {issued[0].key_id} of {issued[0].role} account {issued[0].label}; it is not shown again")
        return
    for key in issued:
        typer.echo(f"{key.label}\t{key.key}")


def bind_account(
    label: Annotated[str, typer.Argument(help="The account's label, from list-keys.")],
    maps: _Maps = [],  # noqa: B006
    all_maps: Annotated[bool, typer.Option("--all-maps", help="Bind it to no map in particular.")] = False,
    data_dir: DataDir = None,
) -> None:
    """Bind an account with all its keys to maps, in place of those it was bound to.

    It reads, reviews and reports about these only. A map need not be there yet: it is bound to the name.
    """
    if bool(maps) == all_maps:
        raise typer.BadParameter("give --map, once for each map, or --all-maps")
    scope = ALL_MAPS if all_maps else MapScope(frozenset(maps))

    async def work(connection: AsyncConnection) -> list[str]:
        await account_service.bind_account(connection, label, scope)
        return await account_repository.absent_maps(connection, scope)

    _warn_of(in_transaction(data_dir, work))
    say(
        f"account {label} has to do with {_maps(scope.names())}; "
        f"servers that run know it within {account_service.CACHE_SECONDS:.0f} s"
    )


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
    table = Table("key id", "role", "account", "maps", "made", "state")
    for row in rows:
        made = f"{row.created_at:%Y-%m-%d %H:%M}"
        table.add_row(row.id, row.role, escape(row.account_label), escape(_maps(row.maps)), made, _key_state(row, now))
    Console().print(table)


def _warn_of(absent: list[str]) -> None:
    if absent:
        say(f"not here yet: {_maps(absent)}")


def _maps(names: list[str] | None) -> str:
    return "all" if names is None else ", ".join(names)


def _key_state(row: Any, now: datetime) -> str:
    if row.revoked_at is not None:
        return f"revoked {row.revoked_at:%Y-%m-%d}"
    if row.expires_at is None:
        return "valid"
    return f"{'ended' if row.expires_at <= now else 'valid until'} {row.expires_at:%Y-%m-%d %H:%M}"
