"""The one place that speaks HTTP: everything above sees `Request`, `Response` and `Transport`.

To use another HTTP library, write a class with `send` and `close` and hand it to `Server`.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from typing import Any, Protocol

import httpx

from slamcu_client.errors import Fault, TransportError

_SAFE = frozenset({"GET", "HEAD"})


@dataclass(frozen=True, slots=True)
class Request:
    """An HTTP request; its headers stay out of its text because they carry the API key."""

    method: str
    url: str
    headers: Mapping[str, str] = field(default_factory=dict, repr=False)
    content: bytes = field(default=b"", repr=False)


@dataclass(frozen=True, slots=True)
class Response:
    """A whole HTTP answer; the names of its headers are in lower case."""

    status: int
    headers: Mapping[str, str] = field(default_factory=dict)
    content: bytes = field(default=b"", repr=False)


class Transport(Protocol):
    """What carries requests to the server."""

    def send(self, request: Request) -> Response:
        """Send a request and return the whole answer, whatever its status; raise TransportError if none came."""

    def close(self) -> None:
        """Give back what is held open; exchanges under way, in other threads, end with a TransportError."""


class HttpxTransport:
    """Carry requests with httpx.

    Redirects are not followed: they would carry the API key elsewhere, and on the road they come from hotspots. A
    connection that was kept may be closed by the other side in the moment it is used again; a GET is then sent once
    more, over a new one (RFC 9110, 9.2.2). Of others nobody knows whether they were taken: their senders decide.

    Parameters
    ----------
    connect_timeout_s, read_timeout_s : longest wait for a connection, and for the next bytes.
    total_timeout_s : longest time for a whole exchange, from the lookup of the name to the last byte of the answer.
    max_answer_bytes : answers larger than this are cut off; it bounds the memory of an embedded computer.
    """

    def __init__(
        self,
        *,
        connect_timeout_s: float = 10.0,
        read_timeout_s: float = 30.0,
        total_timeout_s: float = 120.0,
        max_answer_bytes: int = 64 * 2**20,
    ) -> None:
        self._total_timeout_s, self._max_answer_bytes = total_timeout_s, max_answer_bytes
        self._timeout = httpx.Timeout(read_timeout_s, connect=connect_timeout_s)
        self._tls = httpx.create_ssl_context()
        self._lock = threading.Lock()
        self._idle: list[_Lane] = []
        self._under_way: set[_Exchange] = set()
        self._closed = False

    def send(self, request: Request) -> Response:
        """Send a request and return the whole answer; raise TransportError if none came."""
        with self._lock:
            if self._closed:
                raise TransportError(Fault.INTERRUPTED, "the transport is closed", request)
            lane = self._idle.pop() if self._idle else _Lane(self._timeout, self._tls)
            exchange = _Exchange(lane, request, self._max_answer_bytes)
            self._under_way.add(exchange)
        # in a thread of its own: a lookup of a name takes as long as it takes, and headers may trickle in forever
        threading.Thread(target=self._run, args=(exchange,), name="slamcu-exchange", daemon=True).start()
        in_time = False
        try:
            in_time = exchange.done.wait(self._total_timeout_s)
        finally:
            if not in_time:  # or the wait was interrupted
                with self._lock:
                    self._break_off(exchange)
        if isinstance(exchange.outcome, Response):
            return exchange.outcome
        if exchange.outcome is not None:
            raise exchange.outcome
        if in_time:
            raise TransportError(Fault.INTERRUPTED, "the transport was closed meanwhile", request)
        raise TransportError(Fault.TIMEOUT, f"no whole answer after {self._total_timeout_s:g} s", request)

    def _break_off(self, exchange: _Exchange) -> None:
        # not if it has ended in this very moment: its lane may be another's by now
        if exchange in self._under_way:
            exchange.lane.cut()
            exchange.done.set()

    def _run(self, exchange: _Exchange) -> None:
        outcome = exchange.run()
        with self._lock:
            self._under_way.discard(exchange)
            reusable = not self._closed and not exchange.lane.is_cut
            if reusable:
                self._idle.append(exchange.lane)
            if not exchange.done.is_set():
                exchange.outcome = outcome
                exchange.done.set()
        if not reusable:
            exchange.lane.close()

    def close(self) -> None:
        """Close the connections; exchanges under way in other threads end with a TransportError."""
        with self._lock:
            self._closed = True
            lanes, self._idle = self._idle, []
            for exchange in self._under_way:
                self._break_off(exchange)
        for lane in lanes:
            lane.close()


class _Lane:
    """An httpx client with one connection, which carries one exchange at a time and can be cut by another thread."""

    def __init__(self, timeout: httpx.Timeout, tls: Any) -> None:
        self.client = httpx.Client(
            timeout=timeout, follow_redirects=False, verify=tls, limits=httpx.Limits(max_connections=1)
        )
        self.is_cut = False
        self.is_kept = False  # whether the connection has carried an exchange before this one
        self._socket: socket.socket | None = None

    def trace(self, event: str, info: Mapping[str, Any]) -> None:
        """Take note of the connection; httpcore calls this with what it does."""
        if event.endswith("connect_tcp.started"):
            self.is_kept = False
        if event.endswith(("connect_tcp.complete", "start_tls.complete")):
            self._socket = info["return_value"].get_extra_info("socket")
            if self.is_cut:
                self._shut()

    def cut(self) -> None:
        """Break off the exchange: who reads or writes gets an error, now or as soon as there is a connection."""
        self.is_cut = True
        self._shut()

    def _shut(self) -> None:
        if self._socket is not None:
            with suppress(OSError):  # closed already
                # not the method of TLS sockets, which would take the cipher from under the other thread's hands
                socket.socket.shutdown(self._socket, socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the connection; only for the thread that uses the lane, or when none does."""
        self.client.close()


class _Exchange:
    """A request and what becomes of it; `outcome` counts once `done` is set, None: it was broken off."""

    def __init__(self, lane: _Lane, request: Request, max_answer_bytes: int) -> None:
        self.lane, self.request, self._max_answer_bytes = lane, request, max_answer_bytes
        self.done = threading.Event()
        self.outcome: Response | BaseException | None = None

    def run(self) -> Response | BaseException:
        """Return the answer, or the error that took its place."""
        request = self.request
        try:
            return self._receive()
        except TransportError as error:
            return error
        except (httpx.ConnectError, httpx.ConnectTimeout, httpx.UnsupportedProtocol, httpx.ProxyError) as error:
            return _failed(Fault.UNREACHABLE, f"cannot connect ({_text(error)})", request, error)
        except httpx.TimeoutException as error:
            return _failed(Fault.TIMEOUT, f"timed out ({_text(error)})", request, error)
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            return _failed(Fault.INTERRUPTED, f"broke off ({_text(error)})", request, error)
        except BaseException as error:  # noqa: BLE001  (raised again in the thread that waits)
            return error

    def _receive(self) -> Response:
        request = self.request
        body = bytearray()
        with closing(self._answer()) as answer:
            for chunk in answer.iter_bytes():
                body += chunk
                if len(body) > self._max_answer_bytes:
                    raise TransportError(
                        Fault.INTERRUPTED, f"the answer is larger than {self._max_answer_bytes} bytes", request
                    )
            headers = {name.lower(): value for name, value in answer.headers.items()}
            return Response(answer.status_code, headers, bytes(body))

    def _answer(self) -> httpx.Response:
        """Return the answer as it begins, to the request sent again if a connection that was kept broke off before."""
        lane, request = self.lane, self.request
        sent = lane.client.build_request(
            request.method,
            request.url,
            headers=dict(request.headers),
            content=request.content or None,
            extensions={"trace": lane.trace},
        )
        lane.is_kept = True  # until a new one is made
        try:
            return lane.client.send(sent, stream=True)
        except (httpx.NetworkError, httpx.RemoteProtocolError):
            if not lane.is_kept or lane.is_cut or request.method not in _SAFE:
                raise
        return lane.client.send(sent, stream=True)


def _failed(fault: Fault, message: str, request: Request, cause: Exception) -> TransportError:
    error = TransportError(fault, message, request)
    error.__cause__ = cause
    return error


def _text(error: Exception) -> str:
    return str(error) or type(error).__name__
