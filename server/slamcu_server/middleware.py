"""What surrounds every request: limits, counting, the access log, and an answer to what nobody foresaw."""

from __future__ import annotations

import logging
import time

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from slamcu_server.metrics.instruments import Instruments
from slamcu_server.problems import Problem, on_unexpected_error, problem_response

access_logger = logging.getLogger("slamcu_server.access")

_CLIENT_CLOSED = 499  # for the log and the metrics: the client left before it was answered

_SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",  # unless the endpoint says otherwise
}


class Observe:
    """Count, time and log requests, set the security headers, and answer unexpected errors with a bare 500."""

    def __init__(self, app: ASGIApp, instruments: Instruments) -> None:
        self._app, self._instruments = app, instruments

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection, as ASGI has it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun, status = time.perf_counter(), 0

        async def send_observed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                for name, value in _SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        try:
            await self._app(scope, receive, send_observed)
        except ClientDisconnect:  # a car that lost its network in the middle of an upload: nobody is left to answer
            status = status or _CLIENT_CLOSED
        except Exception as error:  # noqa: BLE001  (the last one that could answer)
            response = on_unexpected_error(error)
            if status == 0:
                await response(scope, receive, send_observed)
        finally:
            seconds = time.perf_counter() - begun
            # The template, not the path: paths hold ids, and would make endless time series.
            route = getattr(scope.get("route"), "path", "unmatched")
            method = scope["method"] if scope["method"] in _METHODS else "other"
            self._instruments.requests.labels(method, route, status).inc()
            self._instruments.latency.labels(method, route).observe(seconds)
            principal = scope.get("state", {}).get("principal")
            who = principal.key_id if principal else "-"
            access_logger.info("%s %s %d %.1f ms key %s", method, route, status, 1000 * seconds, who)


_METHODS = {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"}


class LimitBody:
    """Refuse bodies of more than `limit` bytes, as declared or as they arrive, with 413."""

    def __init__(self, app: ASGIApp, limit: int) -> None:
        self._app, self._limit = app, limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection, as ASGI has it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        declared = Headers(scope=scope).get("content-length", "0")
        if declared.isdecimal() and int(declared) > self._limit:
            error = self._too_large()
            response = problem_response(error.status_code, error.detail, code=error.code)
            await response(scope, receive, send)
            return
        arrived = 0

        async def receive_limited() -> Message:
            nonlocal arrived
            message = await receive()
            if message["type"] == "http.request":
                arrived += len(message.get("body", b""))
                if arrived > self._limit:
                    raise self._too_large()
            return message

        await self._app(scope, receive_limited, send)

    def _too_large(self) -> Problem:
        return Problem(413, "body-too-large", f"a request body has at most {self._limit} bytes; send smaller batches")
