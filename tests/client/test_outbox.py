from __future__ import annotations

import sqlite3
import stat
import subprocess
import sys
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamcu_client import Outbox, OutboxError, SessionClosedError
from slamcu_client.outbox import MessageKey

NOW = datetime(2026, 5, 1, 8, tzinfo=UTC)


def body(message_id: int) -> bytes:
    return f"message {message_id}".encode()


def put(outbox: Outbox, count: int, session: str = "s") -> list[MessageKey]:
    return [MessageKey(session, i) for i in outbox.put(session, [body] * count)]


def test_ids_rise_from_one_within_each_session(tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        assert outbox.put("a", [body, body]) == [1, 2]
        assert outbox.put("b", [body]) == [1]
        assert outbox.put("a", [body]) == [3]
        assert [(m.key, m.body) for m in outbox.pending()] == [
            (("a", 1), b"message 1"),
            (("a", 2), b"message 2"),
            (("b", 1), b"message 1"),
            (("a", 3), b"message 3"),
        ]


def test_ids_go_on_after_acknowledgement_and_reopening(tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        outbox.settle(put(outbox, 3))
        assert outbox.pending() == []
    with Outbox(tmp_path / "o") as outbox:
        assert outbox.put("s", [body]) == [4]
        assert outbox.stats().acknowledged == 3


def test_the_state_of_a_session_survives(tmp_path: Path) -> None:
    until = NOW + timedelta(microseconds=123_457)
    with Outbox(tmp_path / "o") as outbox:
        assert outbox.session("s").reported_until is None
        outbox.put("s", [body], reported_until=until)
        outbox.put("s", [body], closes=True)
    with Outbox(tmp_path / "o") as outbox:
        state = outbox.session("s")
        assert (state.last_message_id, state.reported_until, state.closed) == (2, until, True)
        with pytest.raises(SessionClosedError, match="new session id"):
            outbox.put("s", [body])


def test_a_put_is_all_or_nothing(tmp_path: Path) -> None:
    def fails(_: int) -> bytes:
        raise ValueError("no encoding")

    with Outbox(tmp_path / "o") as outbox:
        with pytest.raises(ValueError, match="no encoding"):
            outbox.put("s", [body, fails])
        assert outbox.pending() == []
        assert outbox.put("s", [body]) == [1]


def test_a_full_outbox_drops_the_oldest_and_counts_them(tmp_path: Path) -> None:
    with Outbox(tmp_path / "o", max_messages=5) as outbox:
        put(outbox, 8)
        assert [m.key.message_id for m in outbox.pending()] == [4, 5, 6, 7, 8]
        assert (outbox.stats().pending, outbox.stats().dropped) == (5, 3)


def test_the_bound_in_bytes_holds(tmp_path: Path) -> None:
    with Outbox(tmp_path / "o", max_bytes=1000) as outbox:
        for _ in range(10):
            outbox.put("s", [lambda _: bytes(300)])
        stats = outbox.stats()
        assert (stats.pending, stats.pending_bytes, stats.dropped) == (3, 900, 7)
        with pytest.raises(OutboxError, match="larger than the whole outbox"):
            outbox.put("s", [lambda _: bytes(1001)])
        assert outbox.stats().pending == 3


def test_interrupted_messages_come_first_and_put_off_ones_last(tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        keys = put(outbox, 6)
        outbox.attempt(keys[3:5])
        outbox.put_off(keys[0])
        assert [m.key.message_id for m in outbox.pending()] == [4, 5, 2, 3, 6, 1]
        assert [m.attempts for m in outbox.pending()] == [1, 1, 0, 0, 0, 0]


def test_a_batch_is_bounded_in_count_and_bytes_but_never_empty(tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        outbox.put("s", [lambda _: bytes(100)] * 5)
        assert len(outbox.pending(limit=2)) == 2
        assert len(outbox.pending(max_bytes=250)) == 2
        assert len(outbox.pending(max_bytes=1)) == 1


def test_the_next_batch_is_found_by_index_and_not_by_sorting_all_that_waits(tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as outbox:
        put(outbox, 1)
    with sqlite3.connect(tmp_path / "o") as db:
        plan = db.execute(
            "EXPLAIN QUERY PLAN SELECT body FROM messages ORDER BY put_off, (attempts = 0), sequence LIMIT 9"
        ).fetchall()
    db.close()
    assert "messages_in_turn" in str(plan)
    assert "B-TREE" not in str(plan)


def test_rejected_messages_are_kept_with_their_reasons_and_bounded(tmp_path: Path) -> None:
    with Outbox(tmp_path / "o", max_rejected=2) as outbox:
        for key in put(outbox, 4)[:3]:
            outbox.settle([], [(key, "bad-position", f"number {key.message_id}")])
        assert [(r.key.message_id, r.body, r.reason, r.detail) for r in outbox.rejected()] == [
            (3, b"message 3", "bad-position", "number 3"),
            (2, b"message 2", "bad-position", "number 2"),
        ]
        assert (outbox.stats().rejected, outbox.stats().pending) == (3, 1)


def test_only_the_owner_may_read_it(tmp_path: Path) -> None:
    loose = tmp_path / "loose"
    loose.touch(0o644)
    for path in (tmp_path / "o", loose):
        with Outbox(path) as outbox:
            put(outbox, 1)
            files = [file for file in tmp_path.iterdir() if file.name.startswith(path.name)]
            assert len(files) == 3, "the database, its log and its shared memory"
            assert {stat.S_IMODE(file.stat().st_mode) for file in files} == {0o600}


@pytest.mark.parametrize("content", [b"not a database at all, but long enough to be taken for one" * 20, b"{}"])
def test_a_file_that_is_no_database_is_named_and_left_alone(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "notes"
    path.write_bytes(content)
    path.chmod(0o644)
    with pytest.raises(OutboxError, match="notes: is there, but is not an outbox"):
        Outbox(path)
    assert path.read_bytes() == content
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_the_database_of_another_program_is_left_alone(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "other") as db:
        db.execute("CREATE TABLE theirs (x)")
    db.close()
    before = (tmp_path / "other").read_bytes()
    with pytest.raises(OutboxError, match="not an outbox"):
        Outbox(tmp_path / "other")
    assert (tmp_path / "other").read_bytes() == before


def test_a_newer_outbox_is_refused(tmp_path: Path) -> None:
    Outbox(tmp_path / "o").close()
    with sqlite3.connect(tmp_path / "o") as db:
        db.execute("PRAGMA user_version = 99")
    db.close()
    with pytest.raises(OutboxError, match="newer"):
        Outbox(tmp_path / "o")


def test_a_folder_that_is_not_there_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(OutboxError, match="cannot be opened: No such file"):
        Outbox(tmp_path / "nowhere" / "o")


def test_threads_and_a_second_opener_share_it_without_equal_ids(tmp_path: Path) -> None:
    with Outbox(tmp_path / "o") as first, Outbox(tmp_path / "o") as second:
        given: list[int] = []

        def work(outbox: Outbox) -> None:
            for _ in range(15):
                given.extend(outbox.put("s", [body]))

        threads = [threading.Thread(target=work, args=(outbox,)) for outbox in (first, first, second)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(given) == list(range(1, 46))
        assert first.stats().pending == 45


_CHILD = """
import sys
from slamcu_client import Outbox
outbox = Outbox(sys.argv[1])
while True:
    for key in outbox.put("s", [lambda i: b"message %d" % i] * 3):
        print(key, flush=True)
"""


def test_what_was_stored_survives_kill_9(tmp_path: Path) -> None:
    told: list[int] = []
    for stop_after in (20, 40, 60):
        with subprocess.Popen(
            [sys.executable, "-c", _CHILD, str(tmp_path / "o")], stdout=subprocess.PIPE, text=True
        ) as child:
            assert child.stdout is not None
            for line in child.stdout:
                told.append(int(line))
                if len(told) >= stop_after:
                    child.kill()
                    break
            told.extend(int(line) for line in child.stdout if line.endswith("\n"))
    with Outbox(tmp_path / "o") as outbox:
        messages = outbox.pending(limit=10_000)
    ids = [message.key.message_id for message in messages]
    assert len(told) == len(set(told)), "no id was given twice across three crashes"
    assert set(told) <= set(ids), "everything that put() returned is there"
    assert ids == list(range(1, len(ids) + 1)), "no id was skipped or doubled"
    assert len(ids) % 3 == 0, "a put is there whole or not at all"
    assert all(message.body == body(message.key.message_id) for message in messages)
    with sqlite3.connect(tmp_path / "o") as db:
        assert db.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    db.close()


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["put", "ack", "reject", "drop"]), st.integers(0, 5)), max_size=30))
def test_every_message_is_accounted_for(steps: list[tuple[str, int]]) -> None:
    """Pending, acknowledged, rejected and dropped always add up to all that was put in."""
    with TemporaryDirectory() as folder, Outbox(Path(folder) / "o", max_messages=6) as outbox:
        total = 0
        for step, count in steps:
            waiting = [message.key for message in outbox.pending()]
            if step == "put":
                total += len(outbox.put("s", [body] * count))
            elif step == "ack":
                outbox.settle(waiting[:count])
                outbox.settle(waiting[:count])  # again: nothing more happens
            elif step == "reject":
                for _ in range(2):
                    outbox.settle([], [(key, "bad", "") for key in waiting[:count]])
            stats = outbox.stats()
            assert stats.pending == len(outbox.pending())
            assert stats.pending_bytes == sum(len(message.body) for message in outbox.pending())
            assert stats.pending <= 6
            assert total == stats.pending + stats.acknowledged + stats.rejected + stats.dropped
