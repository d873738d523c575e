from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slamcu_client import (
    AnswerError,
    AuthenticationError,
    ConnectionSettingsError,
    Outbox,
    Request,
    Response,
    RetryPolicy,
    Server,
    Uploader,
    UploadPolicy,
)
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import serialize_message

IMPATIENT = UploadPolicy(max_messages=4, idle_s=0.01, retry=RetryPolicy(first_wait_s=0.001, longest_wait_s=0.002))


def encode(session: str = "s") -> Callable[[int], bytes]:
    return lambda message_id: serialize_message(ReportMessage(session, message_id, software_version="test"))


def fill(outbox: Outbox, count: int, session: str = "s") -> dict[tuple[str, int], bytes]:
    ids = outbox.put(session, [encode(session)] * count)
    return {(session, message_id): encode(session)(message_id) for message_id in ids}


@pytest.fixture
def outbox(tmp_path: Path):
    with Outbox(tmp_path / "outbox") as box:
        yield box


@pytest.fixture
def uploader(outbox: Outbox, server: Server) -> Uploader:
    return Uploader(outbox, server, IMPATIENT, rng=np.random.default_rng(0))


def test_messages_arrive_in_order_in_bounded_batches_with_their_bytes(fake, outbox, uploader) -> None:
    sent = fill(outbox, 10)
    result = uploader.flush(30.0)
    assert (result.accepted, result.duplicates, result.rejected, result.remaining) == (10, 0, 0, 0)
    assert fake.stored == sent
    assert [len(batch) for batch in fake.batches] == [4, 4, 2]
    assert [key for batch in fake.batches for key in batch] == list(sent)
    assert outbox.stats().acknowledged == 10


def test_batches_are_bounded_in_bytes(fake, outbox, server) -> None:
    sent = fill(outbox, 6)
    two = 2 * max(map(len, sent.values()))
    assert Uploader(outbox, server, replace(IMPATIENT, max_bytes=two)).flush(30.0).accepted == 6
    assert [len(batch) for batch in fake.batches] == [2, 2, 2]


def test_an_empty_outbox_asks_nothing_of_the_server(fake, uploader) -> None:
    assert uploader.flush(30.0).remaining == 0
    assert fake.batches == []


def test_a_lost_answer_makes_a_duplicate_and_not_a_second_message(fake, faults, outbox, uploader) -> None:
    sent = fill(outbox, 8)
    fake.faults.extend([faults.store_and_hang_up, faults.store_and_break_off])
    result = uploader.flush(30.0)
    assert fake.stored == sent
    assert (result.accepted, result.duplicates, result.remaining) == (4, 4, 0)
    assert fake.batches[0] == fake.batches[1] == fake.batches[2], "the interrupted batch comes first"


@pytest.mark.parametrize("status", [429, 500, 502, 503, 504])
def test_a_busy_or_broken_server_is_asked_again(fake, faults, outbox, uploader, status: int) -> None:
    sent = fill(outbox, 3)
    fake.faults.extend([faults.say(faults.problem(status))] * 2)
    assert uploader.flush(30.0).accepted == 3
    assert fake.stored == sent


def test_retry_after_is_heeded(fake, faults, outbox, uploader) -> None:
    fill(outbox, 1)
    fake.faults.append(faults.say(faults.problem(429, **{"Retry-After": "3600"})))
    result = uploader.flush(0.2)
    assert result.remaining == 1
    assert len(fake.batches) == 1, "an hour has not passed"


@pytest.mark.parametrize(
    "answer",
    [
        (200, b"<html>Welcome to the hotel's WLAN</html>"),
        (302, b""),
        (202, {"accepted": 1, "duplicates": 0, "rejected": []}),  # 3 were sent
        (202, {"accepted": 2, "duplicates": 0, "rejected": [{"index": 7, "reason": "x"}]}),
        (202, {"accepted": 1, "duplicates": 0, "rejected": [{"index": 0, "reason": "x"}, {"index": 0, "reason": "x"}]}),
        (202, {"accepted": True, "duplicates": 2, "rejected": []}),
        (202, {"accepted": -1, "duplicates": 4, "rejected": []}),
        (202, [3]),
        (204, b""),
        (202, b"[" * 200_000),
        (202, {"accepted": 2, "duplicates": 0, "rejected": [{"index": 0, "reason": "x", "detail": 9 * [[]]}] * 2}),
    ],
)
def test_an_answer_that_does_not_account_for_the_batch_acknowledges_nothing(
    fake, faults, outbox, uploader, answer: tuple[int, object]
) -> None:
    sent = fill(outbox, 3)
    fake.faults.append(faults.say(faults.Answer(*answer, headers={"Location": "http://wlan.example/"})))
    assert uploader.flush(30.0).accepted == 3
    assert fake.stored == sent
    assert len(fake.batches) == 2


def test_a_rejected_message_does_not_stop_the_others(fake, faults, outbox, uploader) -> None:
    sent = fill(outbox, 10)
    fake.poison = lambda body: ("position-out-of-range", "lat 91") if faults.ids_of(body)[1] in {2, 9} else None
    result = uploader.flush(30.0)
    assert (result.accepted, result.rejected, result.remaining) == (8, 2, 0)
    assert fake.stored == {key: body for key, body in sent.items() if key[1] not in {2, 9}}
    assert [(r.key.message_id, r.reason, r.detail) for r in outbox.rejected()] == [
        (9, "position-out-of-range", "lat 91"),
        (2, "position-out-of-range", "lat 91"),
    ]


@pytest.mark.parametrize(("status", "reason"), [(400, "refused"), (422, "refused"), (413, "too-large")])
def test_a_batch_that_is_refused_whole_is_split_until_the_bad_message_stands_alone(
    *, fake, faults, outbox, uploader, status: int, reason: str
) -> None:
    sent = fill(outbox, 9)
    fake.poison = lambda body: faults.problem(status, "No good") if faults.ids_of(body)[1] == 3 else None
    result = uploader.flush(30.0)
    assert (result.remaining, result.rejected) == (0, 1)
    assert fake.stored == {key: body for key, body in sent.items() if key[1] != 3}
    (bad,) = outbox.rejected()
    assert (bad.key.message_id, bad.reason) == (3, reason)
    assert "No good" in bad.detail


def test_a_server_that_takes_only_small_batches_gets_them(fake, outbox, uploader) -> None:
    sent = fill(outbox, 12)
    fake.max_batch = 1
    assert uploader.flush(30.0).accepted == 12
    assert fake.stored == sent
    assert outbox.stats().rejected == 0


@pytest.mark.parametrize(
    "answer",
    [
        {"headers": {"Retry-After": "Mon, 01 Jan 2024 00:00:00 +99999999999999"}, "document": b""},
        {"headers": {"Content-Type": "application/problem+json"}, "document": b"[" * 200_000},
        {"headers": {"Content-Type": "application/problem+json"}, "document": {"title": "\ud800", "detail": [[{}]]}},
    ],
)
def test_an_odd_answer_does_not_end_the_upload(
    fake, faults, outbox, uploader, wait_until, *, answer: dict[str, object]
) -> None:
    sent = fill(outbox, 3)
    fake.faults.append(faults.say(faults.Answer(503, **answer)))
    with uploader.in_background():
        wait_until(lambda: len(fake.stored) == 3)
    assert fake.stored == sent
    assert (uploader.health.failures, uploader.health.unexpected) == (1, 0), "foreseen, and no error of ours"


def test_the_servers_words_are_stored_as_one_printable_line(fake, outbox, uploader) -> None:
    fill(outbox, 1)
    fake.poison = lambda _body: ("\ud800bad\r\nposition", "lat\x1b[2J 91 \u202e" + 1000 * "x")
    assert uploader.flush(30.0).rejected == 1
    (bad,) = outbox.rejected()
    assert bad.reason == "bad position"
    assert bad.detail.startswith("lat [2J 91 xxx")
    assert len(bad.detail) == 300


class Broken:
    """A transport that fails as none should, and works again when it is told to."""

    def __init__(self, answer: Callable[[], Response]) -> None:
        self.answer = answer

    def send(self, request: Request) -> Response:
        return self.answer()

    def close(self) -> None:
        """Hold nothing."""


def test_a_failure_that_nobody_foresaw_is_told_and_tried_again(outbox, caplog, wait_until) -> None:
    fill(outbox, 2)
    answers = [ZeroDivisionError("what\nnow"), Response(202, {}, b'{"accepted": 2, "duplicates": 0, "rejected": []}')]

    def answer() -> Response:
        one = answers.pop(0)
        if isinstance(one, Exception):
            assert not uploader.health.failing
            raise one
        assert (uploader.health.failing, uploader.health.refused) == (True, False)
        return one

    uploader = Uploader(outbox, Server("http://localhost", "key", Broken(answer)), IMPATIENT)
    with uploader.in_background():
        wait_until(lambda: outbox.stats().pending == 0)
    health = uploader.health
    assert (health.failing, health.failures, health.unexpected) == (False, 1, 1)
    assert health.last_failure == "ZeroDivisionError: what now"
    assert health.last_failure_at is not None
    assert "Traceback" in caplog.text


def test_a_message_that_the_server_trips_over_lets_the_others_pass(fake, faults, outbox, uploader) -> None:
    sent = fill(outbox, 9)
    fake.poison = lambda body: faults.problem(500) if faults.ids_of(body)[1] == 1 else None
    for _ in range(100):
        uploader._step()
    assert fake.stored == {key: body for key, body in sent.items() if key[1] != 1}
    assert outbox.stats().pending == 1, "kept: the fault may be the server's"
    fake.poison = lambda _body: None
    assert uploader.flush(30.0).remaining == 0
    assert fake.stored == sent


@pytest.mark.parametrize("patience", [1, 3])
def test_others_go_first_after_so_many_failures_over_one_message(fake, faults, outbox, server, patience: int) -> None:
    fill(outbox, 2)
    fake.poison = lambda body: faults.problem(500) if faults.ids_of(body)[1] == 1 else None
    uploader = Uploader(outbox, server, replace(IMPATIENT, max_messages=1, failures_before_put_off=patience))
    for _ in range(patience + 1):
        uploader._step()
    assert fake.batches == [[("s", 1)]] * patience + [[("s", 2)]]


def test_a_key_that_is_not_accepted_stops_the_upload_and_keeps_the_data(fake, outbox) -> None:
    fill(outbox, 3)
    with Server(fake.url, "wrong-key") as server:
        uploader = Uploader(outbox, server, IMPATIENT)
        with pytest.raises(AuthenticationError, match=r"API key is not accepted .*Unknown key") as caught:
            uploader.flush(30.0)
        assert caught.value.response.status == 401
        assert "wrong-key" not in f"{caught.value} {caught.value.request!r}", "keys stay out of logs"
        with pytest.raises(AuthenticationError):
            uploader.run(threading.Event())
        assert uploader.health.refused
        assert "API key is not accepted" in uploader.health.last_failure
        with pytest.raises(AuthenticationError), uploader.in_background():
            pass
    assert outbox.stats().pending == 3


def test_a_key_that_may_not_report_stops_the_upload(fake, faults, outbox, uploader) -> None:
    fill(outbox, 3)
    fake.faults.append(faults.say(faults.problem(403, "Providers only read")))
    with pytest.raises(AuthenticationError, match="may not do this"):
        uploader.flush(30.0)
    assert outbox.stats().pending == 3


def test_a_wrong_address_stops_the_upload_and_keeps_the_data(fake, faults, outbox, uploader) -> None:
    fill(outbox, 3)
    fake.faults.append(faults.say(faults.problem(404)))
    with pytest.raises(AnswerError, match="answered 404"):
        uploader.flush(30.0)
    assert outbox.stats().pending == 3


@pytest.mark.parametrize("status", [400, 401, 403, 404, 405, 407, 413, 415, 422, 451, 511])
def test_what_a_middleman_says_neither_rejects_a_message_nor_ends_the_upload(
    fake, faults, outbox, uploader, status: int
) -> None:
    sent = fill(outbox, 10)
    fake.faults.extend(faults.say(answer) for answer in faults.middleman(status))
    result = uploader.flush(30.0)
    assert (result.accepted, result.rejected, result.remaining) == (10, 0, 0)
    assert fake.stored == sent
    assert uploader.health.failures == len(faults.middleman(status))
    assert f"no slamcu server answered {status}" in uploader.health.last_failure
    assert uploader.health.strangers == 0, "what came last came from the server"


def test_who_hears_only_strangers_is_told_loudly_and_once(fake, faults, outbox, uploader, caplog) -> None:
    """A wrong address that somebody else answers looks like a hotspot that never goes away."""
    fill(outbox, 3)
    fake.faults.extend([faults.say(faults.problem(503))] * 2)
    fake.faults.extend([faults.hang_up, *(faults.say(answer) for answer in faults.middleman(404) * 2)])
    for heard in (0, 0, 0, *range(1, 13)):
        assert uploader._step() > 0.0
        assert uploader.health.strangers == heard
    (warning,) = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert warning == (
        f"5 answers in a row came from no slamcu server: is {fake.url} its address? "
        "(something that is no slamcu server answered 404)"
    )
    assert uploader.flush(30.0).accepted == 3
    assert uploader.health.strangers == 0


def test_a_middleman_is_not_asked_in_a_hurry(fake, faults, outbox, server) -> None:
    fill(outbox, 300)
    (page, *_) = faults.middleman(413)
    fake.faults.extend([faults.say(page)] * 1000)
    result = Uploader(outbox, server).flush(1.2)
    assert (result.rejected, result.remaining) == (0, 300)
    assert len(fake.batches) <= 3, "half a second to a second after the first, one to two after the second"


def test_a_message_that_a_firewall_dislikes_lets_the_others_pass(fake, faults, outbox, uploader) -> None:
    sent = fill(outbox, 9)
    (page, *_) = faults.middleman(403)
    fake.poison = lambda body: page if faults.ids_of(body)[1] == 1 else None
    for _ in range(100):
        uploader._step()
    assert fake.stored == {key: body for key, body in sent.items() if key[1] != 1}
    assert (outbox.stats().pending, outbox.stats().rejected) == (1, 0)


def test_offline_nothing_is_lost_and_later_all_arrives(fake, outbox, server) -> None:
    sent = fill(outbox, 5)
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # bound, not listening: connections are refused
        with Server(f"http://127.0.0.1:{nobody.getsockname()[1]}", "key") as gone:
            result = Uploader(outbox, gone, IMPATIENT).flush(0.3)
    assert (result.accepted, result.remaining) == (0, 5)
    assert Uploader(outbox, server, IMPATIENT).flush(30.0).accepted == 5
    assert fake.stored == sent


def test_the_same_ids_with_other_bytes_are_rejected_by_name(fake, outbox, uploader) -> None:
    fake.stored["s", 1] = b"what another run has sent"
    fill(outbox, 2)
    assert uploader.flush(30.0).accepted == 1
    assert [r.reason for r in outbox.rejected()] == ["conflicting-bytes"]


def test_in_the_background_messages_leave_while_others_come(fake, outbox, uploader) -> None:
    sent: dict[tuple[str, int], bytes] = {}
    with uploader.in_background():
        for _ in range(10):
            sent |= fill(outbox, 2)
        uploader.flush(30.0)
    assert fake.stored == sent
    assert fake.duplicates == 0


def test_the_end_of_the_block_does_not_wait_for_a_slow_exchange(outbox, wait_until) -> None:
    fill(outbox, 2)
    asked, go_on, answered = threading.Event(), threading.Event(), threading.Event()

    def answer() -> Response:
        asked.set()
        go_on.wait(20.0)
        answered.set()
        return Response(202, {}, b'{"accepted": 2, "duplicates": 0, "rejected": []}')

    uploader = Uploader(outbox, Server("http://localhost", "key", Broken(answer)), replace(IMPATIENT, leave_s=0.1))
    with uploader.in_background():
        assert asked.wait(20.0)
    assert uploader.flush(0.1).remaining == 2, "one exchange at a time, and no longer than the time that was given"
    assert not answered.is_set()
    go_on.set()
    wait_until(lambda: outbox.stats().pending == 0)
    assert uploader.result.accepted == 2, "an answer that comes late counts too"


@pytest.mark.parametrize(
    ("url", "key", "message"),
    [
        ("example.org", "k", "address looks like"),
        ("ftp://example.org", "k", "address looks like"),
        ("http://[::1", "k", "address looks like"),
        ("http://example.org:65536", "k", "address looks like"),
        ("http://example.org:0", "k", "address looks like"),
        ("http://ex\udcffample.org", "k", "address looks like"),
        ("http://example.org/a b", "k", "address looks like"),
        ("http://user:pw@example.org", "k", "must not carry"),
        ("http://example.org", "", "API key"),
        ("http://example.org", "two words", "API key"),
        ("http://example.org", "a\r\nX-Other: b", "API key"),
    ],
)
def test_wrong_settings_are_named(url: str, key: str, message: str) -> None:
    with pytest.raises(ConnectionSettingsError, match=message):
        Server(url, key)


def test_plain_http_is_warned_of_once_for_each_host(caplog) -> None:
    for _ in range(2):
        for url in ("http://plain.example:8000/a", "http://192.0.2.7", "http://[2001:db8::1]", "https://tls.example"):
            Server(url, "vk_secret").close()
        for url in ("http://localhost:1", "http://car.localhost", "http://127.3.2.1", "http://[::1]:8000"):
            Server(url, "vk_secret").close()
    warned = [record.getMessage().split()[0] for record in caplog.records]
    assert warned == ["plain.example", "192.0.2.7", "2001:db8::1"]
    assert "vk_secret" not in caplog.text


def test_the_servers_words_forge_no_line_of_the_log(fake, outbox, uploader, caplog) -> None:
    fill(outbox, 1)
    fake.poison = lambda _body: ("bad\nERROR all is lost", "\x1b[31m" + 10_000 * "x")
    assert uploader.flush(30.0).rejected == 1
    (line,) = [record.getMessage() for record in caplog.records if "rejected" in record.getMessage()]
    assert line.isprintable()
    assert len(line) < 700


_FAULTS = ["hang_up", "store_and_hang_up", "store_and_break_off", "429", "500", "503", "page", "ok"]


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    plan=st.lists(st.sampled_from(_FAULTS), max_size=12),
    count=st.integers(1, 15),
    poisoned=st.sets(st.integers(1, 15), max_size=3),
    batch=st.integers(1, 6),
    restarts=st.lists(st.integers(0, 3), max_size=3),
)
def test_whatever_happens_nothing_is_lost_and_nothing_doubled(
    *, fake, faults, server, tmp_path_factory, plan, count, poisoned, batch, restarts
) -> None:
    """Any faults, any restarts in between, any poison: each message ends in exactly one place."""
    fake.stored.clear()
    fake.faults.clear()
    for name in plan:
        if name == "ok":
            fake.faults.append(lambda server, bodies: server.store(bodies))
        elif name == "page":
            fake.faults.append(faults.say(faults.Answer(200, b"<html>")))
        elif name.isdigit():
            fake.faults.append(faults.say(faults.problem(int(name))))
        else:
            fake.faults.append(getattr(faults, name))
    fake.poison = lambda body: ("bad", "") if faults.ids_of(body)[1] in poisoned else None
    path = tmp_path_factory.mktemp("any") / "outbox"
    policy = replace(IMPATIENT, max_messages=batch)
    with Outbox(path) as outbox:
        sent = fill(outbox, count)
    for requests in restarts:  # processes that die after some requests: the next one starts from the file alone
        with Outbox(path) as outbox:
            uploader = Uploader(outbox, server, policy)
            for _ in range(requests):
                uploader._step()
    with Outbox(path) as outbox:
        assert Uploader(outbox, server, policy).flush(60.0).remaining == 0
        stats = outbox.stats()
        rejected = {tuple(r.key) for r in outbox.rejected()}
    good = {key for key in sent if key[1] not in poisoned}
    assert fake.stored == {key: sent[key] for key in good}, "each once, with its own bytes"
    assert rejected == set(sent) - good
    assert (stats.acknowledged, stats.rejected, stats.dropped) == (len(good), len(sent) - len(good), 0)
