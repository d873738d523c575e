"""A provider asks again where the server says when, and not for ever; a connection that has just ended is no matter."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from slamcu_client import Request, Response, Server, TransportError
from slamcu_eval.fleet.provider import CloudError, Provider


class Scripted:
    """A transport that answers as it is told to, the last answer for ever."""

    def __init__(self, *answers: Response) -> None:
        self.answers, self.asked = list(answers), 0

    def send(self, request: Request) -> Response:
        self.asked += 1
        return self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]

    def close(self) -> None:
        pass


BUSY = Response(503, {"retry-after": "1"}, b"busy")
FOR_LONG = Response(503, {"retry-after": "3600"}, b"gone for an hour")


def provider(transport: Any) -> Provider:
    return Provider(Server("http://127.0.0.1:1", "key", transport=transport))


def test_a_busy_server_is_asked_again() -> None:
    transport = Scripted(BUSY, BUSY, Response(200, {}, b"[]"))
    assert provider(transport).get("/v1/maps") == []
    assert transport.asked == 3


@pytest.mark.parametrize("answer", [FOR_LONG, Response(503, {}, b"down"), Response(409, {"retry-after": "1"}, b"no")])
def test_nobody_waits_without_end_or_for_an_answer_that_stays(answer: Response) -> None:
    transport = Scripted(answer)
    with pytest.raises(CloudError):
        provider(transport).get("/v1/maps")
    assert transport.asked == 1


class _Impatient(BaseHTTPRequestHandler):
    """Keeps every connection, and closes it without a word when it is used again."""

    protocol_version = "HTTP/1.1"
    asked: list[str] = []  # noqa: RUF012  (emptied by each test)
    used = False

    def do_GET(self) -> None:
        self.asked.append(self.command)
        if self.used:
            self.close_connection = True
            return
        self.used = True
        self.send_response(200)
        self.send_header("Content-Length", "2")
        self.end_headers()
        self.wfile.write(b"[]")

    def do_POST(self) -> None:
        self.do_GET()

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def impatient() -> Iterator[Provider]:
    """The provider of a server that keeps connections for less long than it seems."""
    _Impatient.asked.clear()
    with ThreadingHTTPServer(("127.0.0.1", 0), _Impatient) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with Server(f"http://127.0.0.1:{server.server_port}", "key") as address:
            yield Provider(address)
        server.shutdown()


def test_what_is_read_is_read_again_where_the_connection_ended_before_the_answer(impatient: Provider) -> None:
    assert [impatient.get("/v1/maps") for _ in range(3)] == [[]] * 3
    assert len(_Impatient.asked) == 5


def test_a_review_is_never_sent_twice(impatient: Provider) -> None:
    impatient.get("/v1/maps")
    with pytest.raises(TransportError):
        impatient.request("POST", "/v1/changes/1/review")
    assert _Impatient.asked == ["GET", "POST"]
