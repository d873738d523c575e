"""What is believed, looked over and folded again: rebuild, recompute-trust, check, retry."""

from __future__ import annotations

import asyncio
import json
from typing import Annotated

import typer
from sqlalchemy.ext.asyncio import AsyncConnection

from slamcu_core import program
from slamcu_core.errors import SlamcuError
from slamcu_server.commands.common import DataDir, in_transaction, say
from slamcu_server.runtime import open_database
from slamcu_server.settings import Settings


def register(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.command("rebuild")(rebuild)
    app.command("recompute-trust")(recompute_trust)
    app.command("check")(check)
    app.command("retry")(retry)


def rebuild(
    check: Annotated[bool, typer.Option("--check", help="Only compare, and change nothing.")] = False,
    data_dir: DataDir = None,
) -> None:
    """Fold all evidence again from the stored passes, as after a change of policy; with --check, compare only.

    Fails with --check if what is believed is not what was reported.
    """
    with program.ends_at_once():
        from slamcu_server.aggregation import policy, rebuild  # noqa: PLC0415  (the other commands start faster)

    settings = Settings.load(data_dir=data_dir)
    rules = policy.load_policy(settings.policy_file)

    async def run() -> None:
        async with open_database(settings, application_name="slamcu-cli") as engine:
            if not check:
                say(f"folded under policy {rules.version}; {await rebuild.rebuild(engine, rules)} new change entries")
            elif found := await rebuild.differences(engine, rules):
                raise SlamcuError(f"{len(found)} beliefs differ from their passes; the first: {found[0]}")
            else:
                say(f"what is believed is the fold of the stored passes under policy {rules.version}")

    asyncio.run(run())


def recompute_trust(data_dir: DataDir = None) -> None:
    """Judge what contributors said by what others said, make the next trust version, and fold again what it changes.

    Workers do the same every SLAMCU_TRUST_INTERVAL_S. Prints a line for each contributor whose standing has changed:
    account id, tab, share of the policy's trust, tab, right and wrong verdicts.
    """
    with program.ends_at_once():
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
    if done.version is None and not done.changed:
        say("nothing to judge yet")
        return
    for account, standing in done.contributors.items():
        counted = standing.counted
        typer.echo(f"{account}\t{standing.share:.2f}\t{counted.right}\t{counted.wrong}")
    say(
        f"trust version {done.version}: {done.judged} verdicts, {len(done.contributors)} contributors stand otherwise, "
        f"{len(done.gated)} sessions gated, {len(done.released)} let in again"
    )


def check(
    digests: Annotated[
        bool, typer.Option("--digests", help="Read every row, so that two databases can be compared.")
    ] = False,
    data_dir: DataDir = None,
) -> None:
    """Look over what is stored and print it as JSON: messages, the feed, and beliefs against their passes.

    Fails if the feed has a gap, a belief is not the fold of its passes, or messages could not be used.
    """
    with program.ends_at_once():
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
        raise SlamcuError("something is amiss: see feed_gaps, put_aside, differences and messages")


def retry(
    *,
    messages: Annotated[
        bool,
        typer.Option("--messages", help="Quarantined messages too: the workers fuse them, or put them aside again."),
    ] = False,
    data_dir: DataDir = None,
) -> None:
    """Try at once what failed and was put aside, as after a repair; by itself it is tried again within six hours.

    Prints a line for each: kind of work, key, attempts, the last of them, and why it failed, with tabs between.
    """
    with program.ends_at_once():
        from slamcu_server.aggregation import aside, log  # noqa: PLC0415  (the other commands start faster)

    async def run(connection: AsyncConnection) -> tuple[list[aside.PutAside], int]:
        found = await aside.list_all(connection)
        await aside.retry(connection)
        again = await log.release_quarantined(connection) if messages else 0
        await log.call(connection)
        return found, again

    found, again = in_transaction(data_dir, run)
    for one in found:
        typer.echo(f"{one.work}\t{one.key}\t{one.attempts}\t{one.failed_at.isoformat()}\t{one.error}")
    say(f"{len(found)} that were put aside are tried at once, and {again} quarantined messages")
