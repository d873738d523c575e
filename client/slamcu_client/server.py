"""A server and the key to it: addresses, headers, and what its refusals mean."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import cache
from ipaddress import ip_address
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlencode, urlsplit

from slamcu_client.errors import AnswerError, AuthenticationError, ConnectionSettingsError
from slamcu_client.received import one_line, parse_json
from slamcu_client.transport import HttpxTransport, Request, Response, Transport
from slamcu_client.version import SOFTWARE_VERSION

_log = logging.getLogger(__name__)
_PROBLEM = "application/problem+json"
_OWN_TYPE = "urn:slamcu:problem:"


class Server:
    """A slamcu server as one vehicle sees it: an address and that vehicle's API key.

    ::

        with Server("https://slamcu.example", api_key) as server:
            Uploader(outbox, server).flush(timeout_s=60)

    Parameters
    ----------
    url : address of the server, https or http, with a path prefix if it has one. Over http the key can be read on the
        way, which is logged as a warning, unless the host is this machine.
    api_key : the vehicle's key.
    transport : what carries the requests; httpx unless something else is given.

    Raises ConnectionSettingsError for an address or key of the wrong form.
    """

    def __init__(self, url: str, api_key: str, transport: Transport | None = None) -> None:
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise ConnectionSettingsError(f"a server's address looks like https://host[:port], not {url!r}") from error
        if port == 0 or not url.isprintable() or " " in url:
            raise ConnectionSettingsError(f"a server's address looks like https://host[:port], not {url!r}")
        if parts.scheme not in {"http", "https"} or not parts.hostname or parts.query or parts.fragment:
            raise ConnectionSettingsError(f"a server's address looks like https://host[:port], not {url!r}")
        if parts.username is not None:
            raise ConnectionSettingsError("a server's address must not carry a user name or password")
        if not api_key or not api_key.isascii() or not api_key.isprintable() or " " in api_key:
            raise ConnectionSettingsError("an API key is one word of visible ASCII characters")
        if parts.scheme == "http" and not _is_loopback(parts.hostname):
            _warn_of_plain_http(parts.hostname)
        self.url = url.rstrip("/")
        self._api_key = api_key
        self._transport = HttpxTransport() if transport is None else transport

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    def exchange(
        self,
        method: str,
        path: str,
        *,
        query: Mapping[str, str] | str = "",
        headers: Mapping[str, str] | None = None,
        content: bytes = b"",
    ) -> tuple[Request, Response]:
        """Send one request and return it with its answer, whatever the status.

        Raises TransportError if no whole answer came.
        """
        query = query if isinstance(query, str) else urlencode(query)
        request = Request(
            method,
            f"{self.url}{path}" + (f"?{query}" if query else ""),
            {"Authorization": f"Bearer {self._api_key}", "User-Agent": SOFTWARE_VERSION, **(headers or {})},
            content,
        )
        return request, self._transport.send(request)


def _is_loopback(host: str) -> bool:
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:  # a name
        return False


@cache
def _warn_of_plain_http(host: str) -> None:
    """Warn of a host, once in the life of the process."""
    _log.warning("%s is spoken to over plain http: whoever carries the traffic can read the API key", host)


def is_own_problem(response: Response) -> bool:
    """Tell whether an answer is a problem document of a slamcu server, and not of a hotspot or proxy in front of it.

    Only such an answer may end an upload, reject a message or say that there is no such map.
    """
    kind = _problem(response).get("type")
    return isinstance(kind, str) and kind.startswith(_OWN_TYPE)


def _problem(response: Response) -> dict[str, Any]:
    """Return the members of a problem document (RFC 9457), whoever made it; none if the answer is something else."""
    if response.headers.get("content-type", "").split(";")[0].strip().lower() != _PROBLEM:
        return {}
    try:
        document = parse_json(response.content)
    except ValueError:
        return {}
    return document if isinstance(document, dict) else {}


def describe(response: Response) -> str:
    """Say in one line who answered, and what that objects to."""
    document = _problem(response)
    text = one_line(": ".join(part for name in ("title", "detail") if isinstance(part := document.get(name), str)))
    who = "the server" if is_own_problem(response) else "something that is no slamcu server"
    return f"{who} answered {response.status}" + (f", {text}" if text else "")


def refuse_unauthorized(request: Request, response: Response) -> None:
    """Raise AuthenticationError if the server itself answered 401 or 403."""
    if not is_own_problem(response):
        return
    if response.status == 401:
        raise AuthenticationError(f"the API key is not accepted ({describe(response)})", request, response)
    if response.status == 403:
        raise AuthenticationError(f"the API key may not do this ({describe(response)})", request, response)


def unexpected(request: Request, response: Response) -> AnswerError:
    """Return the error for an answer that is none of those hoped for."""
    return AnswerError(describe(response), request, response)
