"""The exceptions of the vehicle SDK.

::

    SlamcuError
    └── ClientError
        ├── SessionError            the caller used a session wrongly
        │   ├── SessionClockError
        │   └── SessionClosedError
        ├── OutboxError             the file that holds unsent messages cannot be used
        ├── ConnectionSettingsError the server's address or key has the wrong form
        ├── TransportError          no whole answer came back (carries the request)
        ├── AnswerError             the server answered, and not as hoped (carries request and answer)
        │   └── AuthenticationError
        └── MapUnavailableError     neither the server nor the cache has the map
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

from slamcu_core.errors import SlamcuError

if TYPE_CHECKING:
    from slamcu_client.transport import Request, Response


class ClientError(SlamcuError):
    """Base of every error that the vehicle SDK raises on purpose."""


class SessionError(ClientError, ValueError):
    """A session was given what it cannot use, such as a time before the last one or an unknown sensor."""


class SessionClockError(SessionError):
    """A time is before the last one, or more than an hour after it.

    One such record is lost. If they go on, the car's clock has been set: a new session is due.
    """


class SessionClosedError(SessionError):
    """The session is closed; a new drive needs a new session id."""


class OutboxError(ClientError):
    """The outbox cannot be read or written."""


class ConnectionSettingsError(ClientError, ValueError):
    """The server's address or the API key has the wrong form."""


class Fault(StrEnum):
    """How an exchange with the server broke off."""

    UNREACHABLE = "unreachable"  # no connection: the server saw nothing of it
    TIMEOUT = "timeout"  # too slow: the server may have taken it
    INTERRUPTED = "interrupted"  # broke off halfway: the server may have taken it


class TransportError(ClientError):
    """No whole answer came back, so nobody knows whether the server took the request.

    Parameters
    ----------
    fault : how it broke off.
    message : what happened, for people.
    request : what was sent.
    """

    def __init__(self, fault: Fault, message: str, request: Request) -> None:
        self.fault, self.request = fault, request
        super().__init__(f"{request.method} {request.url}: {message}")


class AnswerError(ClientError):
    """The server answered, but not with what the request asked for.

    Parameters
    ----------
    message : what was expected, for people.
    request, response : the exchange.
    """

    def __init__(self, message: str, request: Request, response: Response) -> None:
        self.request, self.response = request, response
        super().__init__(f"{request.method} {request.url}: {message}")


class AuthenticationError(AnswerError):
    """The server itself does not accept the API key (401) or does not let it do this (403)."""


class MapUnavailableError(ClientError):
    """The map can be had neither from the server nor from the cache."""
