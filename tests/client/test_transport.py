from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, suppress

import pytest

from slamcu_client import HttpxTransport, Request, TransportError
from slamcu_client.errors import Fault

OK = b"HTTP/1.1 200 OK\r\nContent-Type: text/plain\r\nX-Mixed-Case: yes\r\n"
HELLO = OK + b"Content-Length: 5\r\n\r\nhello"
Talk = Callable[[socket.socket], None]


@pytest.fixture
def over() -> threading.Event:
    """Set when the test is over: lets a server that hangs go."""
    return threading.Event()


@pytest.fixture
def speaks(over: threading.Event) -> Iterator[Callable[..., str]]:
    """`speaks(talk, ...)`: the URL of a server that lets each `talk` answer over the bare socket of a connection.

    A talk begins when the first request has been read; it may read more. There are no more connections than talks.
    """
    listener = socket.create_server(("127.0.0.1", 0))
    threads: list[threading.Thread] = []

    def start(*talks: Talk) -> str:
        def work() -> None:
            for talk in talks:
                try:
                    connection, _ = listener.accept()
                except OSError:
                    return  # the test is over
                with connection, suppress(OSError):  # the client may hang up
                    connection.recv(65536)
                    talk(connection)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        threads.append(thread)
        return f"http://127.0.0.1:{listener.getsockname()[1]}/"

    yield start
    over.set()
    with suppress(OSError):
        listener.shutdown(socket.SHUT_RDWR)
    for thread in threads:
        thread.join(10.0)
    listener.close()


@pytest.fixture
def transport() -> Iterator[HttpxTransport]:
    carrier = HttpxTransport(connect_timeout_s=5.0, read_timeout_s=0.3, total_timeout_s=0.6, max_answer_bytes=1000)
    yield carrier
    carrier.close()


def exchanges() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "slamcu-exchange"]


def fault_of(transport: HttpxTransport, url: str) -> Fault:
    request = Request("GET", url, {"Authorization": "Bearer secret"})
    with pytest.raises(TransportError) as caught:
        transport.send(request)
    assert caught.value.request is request
    assert "secret" not in str(caught.value)
    return caught.value.fault


def test_a_whole_answer(speaks, transport) -> None:
    url = speaks(lambda connection: connection.sendall(OK + b"Content-Length: 5\r\n\r\nhello"))
    response = transport.send(Request("GET", url))
    assert (response.status, response.content, response.headers["x-mixed-case"]) == (200, b"hello", "yes")


def test_redirects_are_answers_and_not_followed(speaks, transport) -> None:
    head = b"HTTP/1.1 302 Found\r\nLocation: http://192.0.2.1/\r\nContent-Length: 0\r\n\r\n"
    assert transport.send(Request("GET", speaks(lambda connection: connection.sendall(head)))).status == 302


def test_nobody_there(transport) -> None:
    assert fault_of(transport, "http://127.0.0.1:1/") is Fault.UNREACHABLE


def test_a_server_that_hangs_up(speaks, transport) -> None:
    assert fault_of(transport, speaks(lambda connection: None)) is Fault.INTERRUPTED


def test_an_answer_cut_short(speaks, transport) -> None:
    url = speaks(lambda connection: connection.sendall(OK + b"Content-Length: 50\r\n\r\nhello"))
    assert fault_of(transport, url) is Fault.INTERRUPTED


def test_an_answer_that_is_no_http(speaks, transport) -> None:
    assert (
        fault_of(transport, speaks(lambda connection: connection.sendall(b"220 mail ready\r\n"))) is Fault.INTERRUPTED
    )


def test_a_server_that_says_nothing(speaks, over, transport) -> None:
    assert fault_of(transport, speaks(lambda connection: over.wait(30.0))) is Fault.TIMEOUT


def test_a_server_that_trickles_forever(speaks, over, transport) -> None:
    def trickle(connection: socket.socket) -> None:
        connection.sendall(OK + b"Content-Length: 100000\r\n\r\n")
        while not over.wait(0.05):
            connection.sendall(b".")

    assert fault_of(transport, speaks(trickle)) is Fault.TIMEOUT


def test_headers_that_trickle_forever(speaks, over, transport, wait_until) -> None:
    hung_up = threading.Event()

    def trickle(connection: socket.socket) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\n")
        try:
            while not over.wait(0.05):
                connection.sendall(b"X-More: headers\r\n")
        finally:
            hung_up.set()

    assert fault_of(transport, speaks(trickle)) is Fault.TIMEOUT
    assert hung_up.wait(5.0), "the connection is given up with the exchange"
    wait_until(lambda: not exchanges())


def test_a_name_that_is_looked_up_forever(over, transport, monkeypatch, wait_until) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_args, **_kwargs: over.wait(30.0) and [])
    assert fault_of(transport, "http://slamcu.example/") is Fault.TIMEOUT
    over.set()
    wait_until(lambda: not exchanges())


def test_closing_ends_what_is_under_way(speaks, over, wait_until) -> None:
    asked = threading.Event()

    def say_nothing(_connection: socket.socket) -> None:
        asked.set()
        over.wait(30.0)

    transport = HttpxTransport(read_timeout_s=60.0)
    faults: list[Fault] = []
    waiting = threading.Thread(target=lambda url: faults.append(fault_of(transport, url)), args=(speaks(say_nothing),))
    waiting.start()
    assert asked.wait(10.0)
    transport.close()
    waiting.join(5.0)
    assert faults == [Fault.INTERRUPTED]
    assert fault_of(transport, "http://127.0.0.1:1/") is Fault.INTERRUPTED, "closed is closed"
    wait_until(lambda: not exchanges())


def test_one_connection_serves_many_requests(speaks, transport) -> None:
    answer = OK + b"Content-Length: 5\r\n\r\nhello"

    def talk(connection: socket.socket) -> None:
        connection.sendall(answer)
        connection.recv(65536)
        connection.sendall(answer)

    url = speaks(talk)  # accepts one connection only
    assert [transport.send(Request("GET", url)).content for _ in range(2)] == [b"hello"] * 2


def hang_up(connection: socket.socket) -> None:
    connection.close()


def reset(connection: socket.socket) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def tear_off(connection: socket.socket) -> None:
    connection.sendall(HELLO[:-1])
    connection.close()


class Kept:
    """A connection that is good for one exchange and ends when it is used again, and those that come after it."""

    def __init__(self, end: Talk, after: Talk) -> None:
        self._end, self._after = end, after
        self.requests = 0

    def first(self, connection: socket.socket) -> None:
        self.requests += 1
        connection.sendall(HELLO)
        if connection.recv(65536):
            self.requests += 1
            self._end(connection)

    def later(self, connection: socket.socket) -> None:
        self.requests += 1
        self._after(connection)

    def again(self, speaks: Callable[..., str], method: str) -> tuple[Fault | bytes, int]:
        """Ask twice, and return what the second brings and how many requests the server has seen."""
        url = speaks(self.first, self.later, self.later)
        with closing(HttpxTransport()) as transport:
            assert transport.send(Request("GET", url)).content == b"hello"
            try:
                return transport.send(Request(method, url)).content, self.requests
            except TransportError as error:
                return error.fault, self.requests


@pytest.mark.parametrize("end", [hang_up, reset])
def test_a_get_survives_the_end_of_the_connection_that_was_kept_for_it(speaks, end) -> None:
    assert Kept(end, lambda connection: connection.sendall(HELLO)).again(speaks, "GET") == (b"hello", 3)


@pytest.mark.parametrize("end", [hang_up, reset])
def test_of_a_post_nobody_knows_whether_it_was_taken_so_it_is_not_sent_again(speaks, end) -> None:
    assert Kept(end, lambda connection: connection.sendall(HELLO)).again(speaks, "POST") == (Fault.INTERRUPTED, 2)


def test_a_new_connection_that_ends_is_not_tried_again(speaks) -> None:
    assert Kept(hang_up, hang_up).again(speaks, "GET") == (Fault.INTERRUPTED, 3)


def test_an_answer_that_had_begun_is_not_asked_for_again(speaks) -> None:
    assert Kept(tear_off, lambda connection: connection.sendall(HELLO)).again(speaks, "GET") == (Fault.INTERRUPTED, 2)


def test_what_fails_unforeseen_is_raised_where_it_was_asked_for(speaks, transport, monkeypatch) -> None:
    def fail(*_args: object, **_kwargs: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(socket, "getaddrinfo", fail)
    with pytest.raises(ZeroDivisionError):
        transport.send(Request("GET", "http://slamcu.example/"))


def test_an_answer_that_would_fill_the_memory(speaks, transport) -> None:
    url = speaks(lambda connection: connection.sendall(OK + b"Content-Length: 5000\r\n\r\n" + bytes(5000)))
    assert fault_of(transport, url) is Fault.INTERRUPTED
