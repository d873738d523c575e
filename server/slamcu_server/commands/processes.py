"""The processes of the service, and the schema that they need: serve, worker, migrate."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Annotated

import typer

from slamcu_core import program
from slamcu_server.commands.common import DataDir, say
from slamcu_server.database import migrate as migrations
from slamcu_server.runtime import open_database
from slamcu_server.settings import Settings


def register(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.command()(serve)
    app.command()(worker)
    app.command()(migrate)
    app.command("new-migration", hidden=True)(new_migration)


def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on. [SLAMCU_HOST, 127.0.0.1]")] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes any free one. [SLAMCU_PORT, 8000]")] = None,
    worker: Annotated[
        bool | None,
        typer.Option("--worker/--no-worker", help="Aggregate in this process too. [SLAMCU_EMBEDDED_WORKER, yes]"),
    ] = None,
    data_dir: DataDir = None,
    ready_file: Annotated[Path | None, typer.Option(help="Write the URL to this file once it answers.")] = None,
) -> None:
    """Serve the API, until SIGTERM or Ctrl-C."""
    with program.ends_at_once():
        from slamcu_server import serving  # noqa: PLC0415  (the other commands start faster without it)

    settings = Settings.load(host=host, port=port, embedded_worker=worker, data_dir=data_dir)
    serving.configure_logging(settings.log_level)

    def ready(url: str) -> None:
        typer.echo(f"slamcu-server listens on {url} (API documentation: {url}/docs)")
        sys.stdout.flush()
        if ready_file is not None:
            serving.write_ready_file(ready_file, url)

    serving.run_to_end(serving.serve(settings, ready=ready))


def worker(data_dir: DataDir = None) -> None:
    """Aggregate reports in a process of its own, until SIGTERM or Ctrl-C; several may run side by side."""
    with program.ends_at_once():
        from slamcu_server import serving  # noqa: PLC0415

    settings = Settings.load(data_dir=data_dir)
    serving.configure_logging(settings.log_level)

    def ready() -> None:
        typer.echo("slamcu-server worker is aggregating")
        sys.stdout.flush()

    serving.run_to_end(serving.work(settings, ready=ready))


def migrate(data_dir: DataDir = None) -> None:
    """Bring the database to this version's schema; safe while other processes do the same."""
    settings = Settings.load(data_dir=data_dir)

    async def run() -> None:
        async with open_database(settings, application_name="slamcu-migrate", check_schema=False) as engine:
            await migrations.upgrade(engine)

    asyncio.run(run())
    say(f"the database is at revision {migrations.head()}")


def new_migration(message: str, data_dir: DataDir = None) -> None:
    """Write a migration to the tables of the code (for developers of the server), to be reviewed by hand."""
    settings = Settings.load(data_dir=data_dir)

    async def run() -> Path:
        async with open_database(settings, application_name="slamcu-migrate") as engine:
            return await migrations.write_revision(engine, message)

    say(f"wrote {asyncio.run(run())}")
