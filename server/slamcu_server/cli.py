"""The command `slamcu-server`."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
import uvloop
from rich.console import Console
from rich.table import Table
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core.errors import SlamcuError
from slamcu_core.hd_map import MapIdentity
from slamcu_server.accounts import repository as account_repository
from slamcu_server.accounts import service as account_service
from slamcu_server.accounts.schemas import IssuedKey, Role
from slamcu_server.database import migrate as migrations
from slamcu_server.runtime import open_database
from slamcu_server.settings import Settings

T = TypeVar("T")

app = typer.Typer(
    name="slamcu-server",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="""The cloud side of slamcu: takes the change reports of vehicles, fuses them, and serves map changes.

First steps:

    slamcu-server import-map town.geojson
    slamcu-server create-key --role provider --label town-maps
    slamcu-server create-key --role vehicle --count 20 --label van
    slamcu-server serve

Without SLAMCU_DATABASE_URL the server keeps a private PostgreSQL cluster with PostGIS in SLAMCU_DATA_DIR; the commands
may run side by side. Every setting is an environment variable that begins with SLAMCU_.""",
)

DataDir = Annotated[Path | None, typer.Option(help="Home of the private database cluster. [SLAMCU_DATA_DIR]")]


def _say(message: str) -> None:
    typer.echo(message, err=True)


def _in_transaction(data_dir: Path | None, work: Callable[[AsyncConnection], Awaitable[T]]) -> T:
    """Do `work` in one transaction on the database of the settings."""
    settings = Settings.load(data_dir=data_dir)

    async def run() -> T:
        async with open_database(settings, application_name="slamcu-cli") as engine, engine.begin() as connection:
            return await work(connection)

    return asyncio.run(run())


@app.command()
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
    from slamcu_server import serving  # noqa: PLC0415  (the other commands start faster without it)

    settings = Settings.load(host=host, port=port, embedded_worker=worker, data_dir=data_dir)
    serving.configure_logging(settings.log_level)

    def ready(url: str) -> None:
        typer.echo(f"slamcu-server listens on {url} (API documentation: {url}/docs)")
        sys.stdout.flush()
        if ready_file is not None:
            serving.write_ready_file(ready_file, url)

    uvloop.run(serving.serve(settings, ready=ready))


@app.command()
def worker(data_dir: DataDir = None) -> None:
    """Aggregate reports in a process of its own, until SIGTERM or Ctrl-C; several may run side by side."""
    from slamcu_server import serving  # noqa: PLC0415

    settings = Settings.load(data_dir=data_dir)
    serving.configure_logging(settings.log_level)

    def ready() -> None:
        typer.echo("slamcu-server worker is aggregating")
        sys.stdout.flush()

    uvloop.run(serving.work(settings, ready=ready))


@app.command()
def migrate(data_dir: DataDir = None) -> None:
    """Bring the database to this version's schema; safe while other processes do the same."""
    settings = Settings.load(data_dir=data_dir)

    async def run() -> None:
        async with open_database(settings, application_name="slamcu-migrate", check_schema=False) as engine:
            await migrations.upgrade(engine)

    asyncio.run(run())
    _say(f"the database is at revision {migrations.head()}")


@app.command("new-migration", hidden=True)
def new_migration(message: str, data_dir: DataDir = None) -> None:
    """Write a migration to the tables of the code (for developers of the server), to be reviewed by hand."""
    settings = Settings.load(data_dir=data_dir)

    async def run() -> Path:
        async with open_database(settings, application_name="slamcu-migrate") as engine:
            return await migrations.write_revision(engine, message)

    _say(f"wrote {asyncio.run(run())}")


@app.command("rebuild")
def rebuild(
    check: Annotated[bool, typer.Option("--check", help="Only compare, and change nothing.")] = False,
    data_dir: DataDir = None,
) -> None:
    """Fold all evidence again from the stored passes, as after a change of policy; with --check, compare only.

    Fails with --check if what is believed is not what was reported.
    """
    from slamcu_server.aggregation import policy, rebuild  # noqa: PLC0415  (the other commands start faster)

    settings = Settings.load(data_dir=data_dir)
    rules = policy.load_policy(settings.policy_file)

    async def run() -> None:
        async with open_database(settings, application_name="slamcu-cli") as engine:
            if not check:
                _say(f"folded under policy {rules.version}; {await rebuild.rebuild(engine, rules)} new change entries")
            elif found := await rebuild.differences(engine, rules):
                raise SlamcuError(f"{len(found)} beliefs differ from their passes; the first: {found[0]}")
            else:
                _say(f"what is believed is the fold of the stored passes under policy {rules.version}")

    asyncio.run(run())


@app.command("recompute-trust")
def recompute_trust(data_dir: DataDir = None) -> None:
    """Judge what contributors said by what others said, make the next trust version, and fold again what it changes.

    Workers do the same every SLAMCU_TRUST_INTERVAL_S. Prints a line for each contributor whose standing has changed:
    account id, tab, share of the policy's trust, tab, right and wrong verdicts.
    """
    from slamcu_server.aggregation import policy  # noqa: PLC0415  (the other commands start faster)
    from slamcu_server.retraction import corrections  # noqa: PLC0415
    from slamcu_server.trust import job  # noqa: PLC0415

    settings = Settings.load(data_dir=data_dir)
    rules = policy.load_policy(settings.policy_file)

    async def run() -> job.Recomputed | None:
        async with open_database(settings, application_name="slamcu-cli") as engine:
            done = await job.recompute(engine)
            await corrections.correct_all(engine, rules)
            return done

    done = asyncio.run(run())
    if done is None:
        raise SlamcuError("another process is recomputing trust")
    for account, standing in done.contributors.items():
        counted = standing.counted
        typer.echo(f"{account}\t{standing.share:.2f}\t{counted.right}\t{counted.wrong}")
    _say(
        f"trust version {done.version}: {done.judged} verdicts, {len(done.contributors)} contributors stand otherwise, "
        f"{len(done.gated)} sessions gated, {len(done.released)} let in again"
    )


@app.command("check")
def check(
    digests: Annotated[
        bool, typer.Option("--digests", help="Read every row, so that two databases can be compared.")
    ] = False,
    data_dir: DataDir = None,
) -> None:
    """Look over what is stored and print it as JSON: messages, the feed, and beliefs against their passes.

    Fails if the feed has a gap, a belief is not the fold of its passes, or messages could not be used.
    """
    from slamcu_server.aggregation import policy  # noqa: PLC0415  (the other commands start faster)
    from slamcu_server.integrity import service as integrity  # noqa: PLC0415

    settings = Settings.load(data_dir=data_dir)
    rules = policy.load_policy(settings.policy_file)

    async def run() -> integrity.Findings:
        async with open_database(settings, application_name="slamcu-cli") as engine:
            return await integrity.look_over(engine, rules, digests=digests)

    findings = asyncio.run(run())
    typer.echo(json.dumps(findings.to_document(), indent=2))
    if not findings.sound:
        raise SlamcuError("something is amiss: see feed_gaps, differences and messages")


@app.command("import-map")
def import_map(
    *,
    path: Annotated[Path, typer.Argument(metavar="FILE", help="An HD map in GeoJSON.")],
    source: Annotated[str, typer.Option(help="The map's name, where the file does not say or says another.")] = "",
    version: Annotated[str, typer.Option(help="Its version, likewise.")] = "",
    surveyed_at: Annotated[
        datetime | None,
        typer.Option(
            formats=["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S%z"],
            help="When it was surveyed: changes of older evidence that the map does not show are contradicted.",
        ),
    ] = None,
    surveyed_bbox: Annotated[
        str | None, typer.Option(metavar="W,S,E,N", help="Where it was surveyed, in degrees; without it, everywhere.")
    ] = None,
    data_dir: DataDir = None,
) -> None:
    """Make a GeoJSON file the first, or the next, version of the map that it names; all of it or nothing.

    Features keep their identity through their ids: one that the map had before stays the same feature, with what
    vehicles reported about it as long as it is the same thing at the same place; one that is missing is no longer part
    of the map. Open changes that the new version shows are absorbed.
    """
    from slamcu_server.aggregation.policy import load_policy  # noqa: PLC0415  (the other commands start faster)
    from slamcu_server.changes import rebase  # noqa: PLC0415

    survey = rebase.Survey.parse(surveyed_at, surveyed_bbox)
    identity = MapIdentity(source, version)
    policy = load_policy(Settings.load(data_dir=data_dir).policy_file)
    done, rebased = _in_transaction(
        data_dir,
        lambda connection: rebase.import_and_rebase(connection, policy, path, identity=identity, survey=survey),
    )
    name = f"map {done.identity.source} version {done.identity.version}"
    if done.unchanged:
        _say(f"{name} is here already, with the same {done.features} features: nothing to do")
        return
    _say(
        f"{name}: {done.features} features; "
        f"{done.added} added, {done.changed} changed, {done.removed} removed since the version before"
    )
    if rebased != rebase.Rebased():
        _say(
            f"changes: {rebased.absorbed} absorbed, {rebased.contradicted} contradicted, "
            f"{rebased.still_open} still open"
        )


@app.command("create-key")
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

    issued = _in_transaction(data_dir, work)
    if count == 1:
        typer.echo(issued[0].key)
        _say(f"key {issued[0].key_id} of {issued[0].role} account {issued[0].label}; it is not shown again")
        return
    for key in issued:
        typer.echo(f"{key.label}\t{key.key}")


@app.command("rotate-key")
def rotate_key(
    key_id: Annotated[str, typer.Argument(help="The key's id, from list-keys.")],
    grace_hours: Annotated[float, typer.Option(min=0, help="How long the old key still works.")] = 24.0,
    data_dir: DataDir = None,
) -> None:
    """Give a key's account a new key and let the old one end; the account and its reports stay the same."""
    issued = _in_transaction(
        data_dir, lambda connection: account_service.rotate_key(connection, key_id, timedelta(hours=grace_hours))
    )
    typer.echo(issued.key)
    _say(f"key {issued.key_id} of {issued.role} account {issued.label}; it is not shown again")


@app.command("revoke-key")
def revoke_key(
    key_id: Annotated[str, typer.Argument(help="The key's id, from list-keys.")], data_dir: DataDir = None
) -> None:
    """End a key for good, within seconds; what its account reported stays."""
    _in_transaction(data_dir, lambda connection: account_service.revoke_key(connection, key_id))
    _say(f"key {key_id} is revoked; servers that run refuse it within {account_service.CACHE_SECONDS:.0f} s")


@app.command("list-keys")
def list_keys(data_dir: DataDir = None) -> None:
    """List the keys by account; their secrets are not stored."""
    rows = _in_transaction(data_dir, account_repository.list_keys)
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


def main() -> None:
    """Run the command; a user's mistake gets one line and a status that is not 0."""
    try:
        app()
    except SlamcuError as error:
        _say(f"slamcu-server: {error}")
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
