"""The worker: fuse what waits in the message log, as long as it runs. Several may run at once, in any processes."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from datetime import timedelta
from typing import TypeVar

from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from slamcu_core.aggregation import Policy
from slamcu_server.aggregation import log
from slamcu_server.aggregation.attempts import BatchError, attempt, transient
from slamcu_server.aggregation.batch import Fused, process_batch, quarantine
from slamcu_server.aggregation.fading import fade
from slamcu_server.aggregation.forgetting import forget_messages
from slamcu_server.aggregation.policy import count_outdated, load_policy, remember_policy
from slamcu_server.metrics.instruments import Instruments
from slamcu_server.retraction.corrections import correct
from slamcu_server.settings import Settings
from slamcu_server.trust.job import Recomputed, recompute

logger = logging.getLogger(__name__)

T = TypeVar("T")

BATCH_SIZE = 512
"""Messages: more would share what a batch costs by itself, and wait longer for each other (decision 0033)."""

POLL_S = 1.0  # between looks at the log when nobody calls: a notification may be lost with its connection
_HOUSEKEEPING_S = 600.0
_AT_ONCE = 1000


async def run_worker(
    engine: AsyncEngine,
    settings: Settings,
    stop: asyncio.Event,
    *,
    instruments: Instruments | None = None,
    batch_size: int = BATCH_SIZE,
) -> None:
    """Fuse pending messages until `stop` is set; a batch under way is finished first.

    Raises what the database raises when it cannot be reached: the caller starts the worker again. What else goes wrong
    beside the fusing is logged and counted, and tried again at the next housekeeping: reports must go on being fused.
    """

    async def chore(name: str, work: Awaitable[T]) -> T | None:
        try:
            return await work
        except Exception as error:
            if transient(error):
                raise
            logger.exception("%s failed; it is tried again in %.0f s", name, _HOUSEKEEPING_S)
            if instruments is not None:
                instruments.chores_failed.labels(name).inc()
            return None

    policy = load_policy(settings.policy_file)
    async with engine.begin() as connection:
        await remember_policy(connection, policy)
        outdated = await count_outdated(connection, policy)
    if outdated:
        logger.warning(
            "%d beliefs were folded under another policy than %s: run slamcu-server rebuild", outdated, policy.version
        )
    cleaned_at = corrected_at = correct_from = -_HOUSEKEEPING_S
    trusted_at = time.monotonic()
    async with _listening(engine) as caller:
        while not stop.is_set():
            caller.event.clear()
            caller.require()
            begun = time.monotonic()
            fused = await fuse_pending(engine, policy, batch_size)
            if instruments is not None and fused.messages:
                instruments.fused.labels("fused").inc(fused.fused)
                instruments.fused.labels("quarantined").inc(fused.quarantined)
                instruments.batch_seconds.observe(time.monotonic() - begun)
            # What was retracted must not wait for the traffic to cease, nor the traffic for it.
            if begun >= correct_from and (not fused.messages or begun - corrected_at > POLL_S):
                corrected = await chore("correcting", correct(engine, policy))
                if corrected:
                    continue
                corrected_at = begun
                if corrected is None:
                    correct_from = begun + _HOUSEKEEPING_S
            if begun - cleaned_at > _HOUSEKEEPING_S:
                bodies, archive = settings.message_retention_days, settings.archive_retention_days
                await chore("forgetting", forget_bodies(engine, timedelta(days=bodies)))
                await chore("forgetting", forget_archived(engine, timedelta(days=archive)))
                await chore("forgetting", forget_messages(engine, timedelta(days=bodies)))
                ahead = timedelta(seconds=settings.max_clock_ahead_s)
                await chore("fading", fade(engine, policy, clock_ahead=ahead))
                cleaned_at = begun
            if 0 < settings.trust_interval_s < begun - trusted_at:
                trusted_at = begun
                _tell(await chore("trusting", recompute(engine)))
                continue
            if fused.messages:
                continue
            await _first(caller.event, stop, timeout_s=POLL_S)


async def fuse_pending(engine: AsyncEngine, policy: Policy, batch_size: int = BATCH_SIZE) -> Fused:
    """Fuse one batch of what waits; a batch that cannot be fused is tried message by message.

    Then only those that fail by themselves are put aside, each with its reason.
    """
    try:
        return await attempt(lambda: process_batch(engine, policy, limit=batch_size))
    except BatchError as failed:
        logger.warning("a batch of %d messages failed and is tried one by one", len(failed.ids), exc_info=failed)
        done = [await _fuse_alone(engine, policy, message_id) for message_id in failed.ids]
        return Fused(sum(one.fused for one in done), sum(one.quarantined for one in done))


async def drain(engine: AsyncEngine, policy: Policy, batch_size: int = BATCH_SIZE) -> Fused:
    """Fuse until nothing waits that nobody else holds, and return what was done."""
    total = Fused()
    while (done := await fuse_pending(engine, policy, batch_size)).messages:
        total = Fused(total.fused + done.fused, total.quarantined + done.quarantined)
    return total


async def forget_bodies(engine: AsyncEngine, retention: timedelta) -> int:
    """Empty the bodies of messages that were fused longer ago than `retention`, and return how many."""
    return await _in_pieces(engine, lambda connection: log.empty_bodies(connection, retention, _AT_ONCE))


async def forget_archived(engine: AsyncEngine, retention: timedelta) -> int:
    """Delete archived passes that were fused longer ago than `retention`, and return how many."""
    return await _in_pieces(engine, lambda connection: log.forget_archived(connection, retention, _AT_ONCE))


async def _in_pieces(engine: AsyncEngine, work: Callable[[AsyncConnection], Awaitable[int]]) -> int:
    """Do work that does up to _AT_ONCE at a time until nothing is left, a transaction each; return how much it was."""
    done = 0
    while True:
        async with engine.begin() as connection:
            count = await work(connection)
        done += count
        if count < _AT_ONCE:
            return done


async def _fuse_alone(engine: AsyncEngine, policy: Policy, message_id: int) -> Fused:
    try:
        return await attempt(lambda: process_batch(engine, policy, limit=1, ids=[message_id]))
    except BatchError as failed:
        logger.exception("message %d is put aside", message_id)
        await quarantine(engine, message_id, failed.reason)
        return Fused(quarantined=1)


def _tell(done: Recomputed | None) -> None:
    """Log what a new trust version says: somebody may want to look at who lost the server's trust."""
    if done is not None and done.changed:
        lost = sorted(key for key, standing in done.contributors.items() if standing.share < 1.0)
        logger.warning(
            "trust version %s: accounts %s are trusted less; %d sessions gated, %d let in again",
            done.version, lost, len(done.gated), len(done.released),
        )  # fmt: skip


class _Caller:
    """What the log calls on: set whenever messages are logged, and lost with its connection."""

    def __init__(self) -> None:
        self.event = asyncio.Event()
        self._lost = False

    def call(self, *_: object) -> None:
        """Note that something waits."""
        self.event.set()

    def lose(self, *_: object) -> None:
        """Note that nobody can call any more."""
        self._lost = True
        self.event.set()

    def require(self) -> None:
        """Raise ConnectionError if nobody can call any more."""
        if self._lost:
            raise ConnectionError("the connection on which the log calls is lost")


@asynccontextmanager
async def _listening(engine: AsyncEngine) -> AsyncIterator[_Caller]:
    caller = _Caller()
    async with engine.connect() as connection:
        driver = (await connection.get_raw_connection()).driver_connection
        if driver is None:
            raise ConnectionError("the connection to listen on is closed")
        await driver.add_listener(log.CHANNEL, caller.call)
        driver.add_termination_listener(caller.lose)
        try:
            yield caller
        finally:
            driver.remove_termination_listener(caller.lose)
            if not driver.is_closed():
                await driver.remove_listener(log.CHANNEL, caller.call)


async def _first(*events: asyncio.Event, timeout_s: float) -> None:
    """Wait until one of the events is set, or the time is over."""
    waits = [asyncio.create_task(event.wait()) for event in events]
    try:
        await asyncio.wait(waits, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for wait in waits:
            wait.cancel()
        await asyncio.gather(*waits, return_exceptions=True)
