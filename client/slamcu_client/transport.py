"""The one place that speaks HTTP: everything above sees `Request`, `Response` and `Transport`.

To use another HTTP library, write a class with `send` and `close` and hand it to `Server`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import httpx

from slamcu_client.errors import Fault, TransportError


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
        """Give back what is held open."""


class HttpxTransport:
    """Carry requests with httpx.

    Redirects are not followed: they would carry the API key elsewhere, and on the road they come from hotspots.

    Parameters
    ----------
    connect_timeout_s, read_timeout_s : longest wait for a connection, and for the next bytes.
    total_timeout_s : longest time for a whole exchange, so that a trickling answer cannot hold a thread forever.
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
        self._client = httpx.Client(
            timeout=httpx.Timeout(read_timeout_s, connect=connect_timeout_s), follow_redirects=False
        )

    def send(self, request: Request) -> Response:
        """Send a request and return the whole answer; raise TransportError if none came."""
        deadline = time.monotonic() + self._total_timeout_s
        body = bytearray()
        try:
            with self._client.stream(
                request.method, request.url, headers=dict(request.headers), content=request.content or None
            ) as answer:
                for chunk in answer.iter_bytes():
                    body += chunk
                    if len(body) > self._max_answer_bytes:
                        raise TransportError(
                            Fault.INTERRUPTED, f"the answer is larger than {self._max_answer_bytes} bytes", request
                        )
                    if time.monotonic() > deadline:
                        raise TransportError(
                            Fault.TIMEOUT, f"no whole answer after {self._total_timeout_s:g} s", request
                        )
                headers = {name.lower(): value for name, value in answer.headers.items()}
                return Response(answer.status_code, headers, bytes(body))
        except (httpx.ConnectError, httpx.ConnectTimeout, httpx.UnsupportedProtocol, httpx.ProxyError) as error:
            raise TransportError(Fault.UNREACHABLE, f"cannot connect ({_text(error)})", request) from error
        except httpx.TimeoutException as error:
            raise TransportError(Fault.TIMEOUT, f"timed out ({_text(error)})", request) from error
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise TransportError(Fault.INTERRUPTED, f"broke off ({_text(error)})", request) from error

    def close(self) -> None:
        """Close the connections."""
        self._client.close()


def _text(error: Exception) -> str:
    return str(error) or type(error).__name__
