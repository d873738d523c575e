"""Run the application, or the worker alone, until a signal ends it."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any

import uvicorn
import uvloop
from fastapi import FastAPI

from slamcu_core import program
from slamcu_core.errors import SlamcuError
from slamcu_server.aggregation.policy import load_policy
from slamcu_server.aggregation.worker import run_worker
from slamcu_server.app import create_app, create_worker_app
from slamcu_server.logs import DiscreetFormatter
from slamcu_server.metrics.instruments import Instruments
from slamcu_server.runtime import WorkerSupervisor, open_database
from slamcu_server.settings import Settings

_WORKER_GRACE_S = 5.0
_THREADS_GRACE_S = 1.0

logger = logging.getLogger(__name__)


class ServeError(SlamcuError):
    """The server cannot listen where it should."""


class _Server(uvicorn.Server):
    """A uvicorn server that tells when it listens, and leaves the signals to us."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.listening = asyncio.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.listening.set()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield  # uvicorn raises them again when it is done, which would end us before the database is closed


def configure_logging(level: str) -> None:
    """Send the log to standard error, without what errors of the database quote."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(DiscreetFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=level.upper(), handlers=[handler])
    for chatty in ("alembic", "asyncio"):
        logging.getLogger(chatty).setLevel(logging.WARNING)


def _collect_less() -> None:
    """Let the garbage collector look less often, and never at what was made before: reports hold no cycles."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


def run_to_end(main: Coroutine[Any, Any, None]) -> None:
    """Run what a process does; if a thread is busy long after, also after Ctrl-C, end the process without it.

    An event loop that closes waits for its threads, and a resolver may take as long as it likes to look up the name of
    a database that is gone.
    """
    left = threading.Event()

    def leave_soon(code: int) -> None:
        threading.Thread(target=_leave, args=(left, code), daemon=True).start()

    async def run() -> None:
        try:
            await main
        except asyncio.CancelledError:
            leave_soon(program.INTERRUPTED)
            raise
        leave_soon(0)

    try:
        uvloop.run(run())
    finally:
        left.set()


def _leave(left: threading.Event, code: int) -> None:
    """End the process, unless it has been left in time."""
    if left.wait(_THREADS_GRACE_S):
        return
    logger.warning("a thread is still busy; leaving without it")
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


async def serve(settings: Settings, *, ready: Callable[[str], None]) -> None:
    """Serve the API until SIGTERM or SIGINT, calling `ready` with its URL; raises SlamcuError if it cannot start.

    A SIGINT before that is an interruption: CancelledError.
    """
    async with contextlib.AsyncExitStack() as stack:
        stop = await stack.enter_async_context(_stop_signal())
        listener = stack.enter_context(_listener(settings.host, settings.port))
        engine = await stack.enter_async_context(open_database(settings, application_name="slamcu-server"))
        server = _server(create_app(settings, engine=engine), settings)
        serving = asyncio.create_task(server.serve(sockets=[listener]))
        try:
            if await _first(serving, server.listening.wait()):
                _collect_less()
                await _stop_on_ctrl_c(stop)
                ready(_url(settings.host, listener))
                await _first(serving, stop.wait())
        finally:
            server.should_exit = True
            await serving


async def work(settings: Settings, *, ready: Callable[[], None]) -> None:
    """Aggregate reports until SIGTERM or SIGINT, calling `ready` first; raises SlamcuError if it cannot start.

    A SIGINT before that is an interruption: CancelledError.
    """
    load_policy(settings.policy_file)  # the worker would only learn when it starts, again and again
    async with contextlib.AsyncExitStack() as stack:
        stop = await stack.enter_async_context(_stop_signal())
        listener = None
        if settings.worker_port is not None:
            listener = stack.enter_context(_listener(settings.host, settings.worker_port))
        engine = await stack.enter_async_context(open_database(settings, application_name="slamcu-worker"))
        instruments = Instruments()
        supervisor = WorkerSupervisor(lambda asked: run_worker(engine, settings, asked, instruments=instruments))
        if listener is not None:
            server = _server(create_worker_app(engine, supervisor, instruments), settings)
            await stack.enter_async_context(_beside(server, listener, stop))
        _collect_less()
        supervisor.start()
        stack.push_async_callback(supervisor.stop, _WORKER_GRACE_S)
        await _stop_on_ctrl_c(stop)
        ready()
        await stop.wait()


def _server(app: FastAPI, settings: Settings) -> _Server:
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,  # the middleware has one, without secrets
        server_header=False,
        lifespan="on",
        timeout_keep_alive=settings.keep_alive_s,
        timeout_graceful_shutdown=max(1, round(settings.shutdown_grace_s)),
    )
    return _Server(config)


@contextlib.asynccontextmanager
async def _beside(server: _Server, listener: socket.socket, stop: asyncio.Event) -> AsyncIterator[None]:
    """Serve until `stop` or the end of the block; answers under way are given while the block ends."""
    serving = asyncio.create_task(server.serve(sockets=[listener]))

    async def watch() -> None:
        await stop.wait()
        server.should_exit = True

    watching = asyncio.create_task(watch())
    try:
        yield
    finally:
        watching.cancel()
        server.should_exit = True
        await serving


def write_ready_file(path: Path, url: str) -> None:
    """Write the URL to a file that appears whole; raises ServeError if it cannot."""
    unfinished = path.with_name(path.name + ".new")
    try:
        unfinished.write_text(url + "\n")
        unfinished.replace(path)
    except OSError as error:
        raise ServeError(f"cannot write the ready file {path}: {error.strerror or error}") from error


@contextlib.asynccontextmanager
async def _stop_signal() -> AsyncIterator[asyncio.Event]:
    """Give an event that SIGTERM sets."""
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    loop.add_signal_handler(signal.SIGTERM, stop.set)
    try:
        yield stop
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)


async def _stop_on_ctrl_c(stop: asyncio.Event) -> None:
    """From now on SIGINT, too, is the order to stop; before, it interrupts the start: here at the latest."""
    asyncio.get_running_loop().add_signal_handler(signal.SIGINT, stop.set)
    await asyncio.sleep(0)


async def _first(serving: asyncio.Task[None], event: Coroutine[Any, Any, Any]) -> bool:
    """Wait for an event or the end of the server; return whether it was the event."""
    waiting = asyncio.create_task(event)
    await asyncio.wait({serving, waiting}, return_when=asyncio.FIRST_COMPLETED)
    happened = waiting.done()
    waiting.cancel()
    return happened


def _listener(host: str, port: int) -> socket.socket:
    """Take the port before anything is started, so that a port in use costs nothing."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family, backlog=2048)
    except OSError as error:
        raise ServeError(f"cannot listen on {host} port {port}: {error.strerror or error}") from error


def _url(host: str, listener: socket.socket) -> str:
    name = f"[{host}]" if listener.family == socket.AF_INET6 else host
    return f"http://{name}:{listener.getsockname()[1]}"
