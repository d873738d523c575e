"""A provider asks again where the server says when, and not for ever."""

from __future__ import annotations

from typing import Any

import pytest

from slamcu_client import Request, Response, Server
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
