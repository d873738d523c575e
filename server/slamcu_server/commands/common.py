"""What the commands share: the option for the database's home, what is said to people, and one transaction."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated, TypeVar

import typer
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_server.runtime import open_database
from slamcu_server.settings import Settings

T = TypeVar("T")

DataDir = Annotated[
    Path | None,
    typer.Option(
        help="Home of the private database cluster. [SLAMCU_DATA_DIR, ~/.local/share/slamcu; for root /var/lib/slamcu]"
    ),
]


def say(message: str) -> None:
    """Tell people something, on standard error: standard output is for what programs read."""
    typer.echo(message, err=True)


def in_transaction(data_dir: Path | None, work: Callable[[AsyncConnection], Awaitable[T]]) -> T:
    """Do `work` in one transaction on the database of the settings."""
    settings = Settings.load(data_dir=data_dir)

    async def run() -> T:
        async with open_database(settings, application_name="slamcu-cli") as engine, engine.begin() as connection:
            return await work(connection)

    return asyncio.run(run())
