"""The fleet's own records: what each car's outbox says it has sent."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass

from slamcu_eval.scenario.system import Car


@dataclass(frozen=True, slots=True)
class Sent:
    """What a car's outbox knows: the messages that each session made, and what became of them."""

    sessions: dict[str, int]  # number of messages, which have the ids from 1 to it
    closed: bool  # whether every session has come to its end
    pending: int
    acknowledged: int
    rejected: int
    dropped: int

    @property
    def keys(self) -> set[tuple[str, int]]:
        """The messages that were ever made."""
        return {(session, number) for session, last in self.sessions.items() for number in range(1, last + 1)}


def read_outbox(car: Car) -> Sent:
    """Read a car's outbox, beside the car if it is driving, and change nothing in it."""
    with closing(sqlite3.connect(f"file:{car.outbox}?mode=ro", uri=True, timeout=30.0)) as db:
        sessions = db.execute("SELECT session_id, last_message_id, closed FROM sessions").fetchall()
        query = "SELECT pending, acknowledged, rejected, dropped FROM totals"
        pending, acknowledged, rejected, dropped = db.execute(query).fetchone()
    return Sent(
        {session: last for session, last, _ in sessions},
        all(closed for *_, closed in sessions),
        pending,
        acknowledged,
        rejected,
        dropped,
    )


def waiting(cars: Iterable[Car]) -> int:
    """Return how many messages wait in the outboxes of cars; a car that has not made its own yet has none."""
    return sum(read_outbox(car).pending for car in cars if car.outbox.exists())


def acknowledged(cars: Iterable[Car]) -> int:
    """Return how many messages of cars the server has acknowledged."""
    return sum(read_outbox(car).acknowledged for car in cars if car.outbox.exists())
