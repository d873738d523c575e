"""One address before several servers, in a thread: the proxy and the radio network of plain processes."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

Address = tuple[str, int]

_CHUNK = 65536


class Relay:
    """Carry connections to whichever server takes them, in turn; `cut` breaks all and takes no more until `mend`.

    Parameters
    ----------
    servers : asked for each connection, because servers that are started again may have another port.
    host, port : where it listens; port 0 takes any free one.
    """

    def __init__(self, servers: Callable[[], Sequence[Address]], *, host: str = "127.0.0.1", port: int = 0) -> None:
        self._servers, self._host, self._port = servers, host, port
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="relay", daemon=True)
        self._open: set[asyncio.StreamWriter] = set()
        self._cut = False
        self._turn = 0
        self.url = ""

    def __enter__(self) -> Self:
        self._thread.start()
        self._server = asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result()
        self.url = f"http://{self._host}:{self._server.sockets[0].getsockname()[1]}"
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def cut(self) -> None:
        """Break every connection and refuse new ones."""
        self._loop.call_soon_threadsafe(self._set, True)

    def mend(self) -> None:
        """Carry connections again."""
        self._loop.call_soon_threadsafe(self._set, False)

    def _set(self, cut: bool) -> None:
        self._cut = cut
        if cut:
            for writer in self._open:
                writer.transport.abort()

    async def _listen(self) -> asyncio.Server:
        return await asyncio.start_server(self._carry, self._host, self._port)

    async def _end(self) -> None:
        self._set(True)
        self._server.close()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far = None if self._cut else await self._connect()
        if far is None or self._cut:
            writer.transport.abort()
            return
        ends = {writer, far[1]}
        self._open |= ends
        try:
            await asyncio.gather(_pump(reader, far[1]), _pump(far[0], writer))
        finally:
            self._open -= ends
            for end in ends:
                end.transport.abort()

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter] | None:
        servers = list(self._servers())
        self._turn += 1
        for number in range(len(servers)):
            with contextlib.suppress(OSError):
                return await asyncio.open_connection(*servers[(self._turn + number) % len(servers)])
        return None


async def _pump(source: asyncio.StreamReader, target: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await source.read(_CHUNK):
            target.write(data)
            await target.drain()
        if target.can_write_eof():
            target.write_eof()
