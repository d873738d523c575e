"""From ended passes to messages in the outbox, without the filter ever waiting for a disk."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

from slamcu_client.errors import OutboxError
from slamcu_client.outbox import Encode, Outbox
from slamcu_core.errors import SlamcuError, WireError
from slamcu_core.reports import Health, PassReport, ReportMessage
from slamcu_core.sensoris import sendable, serialize_message

_RETRY_S = 1.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ReportPolicy:
    """How ended passes are grouped into messages."""

    interval_s: float = 10.0  # of drive time: so much a crash can lose
    max_passes: int = 64  # per message
    max_waiting_passes: int = 10_000  # bound of memory while the disk does not take them


@dataclass(frozen=True, slots=True)
class _Draft:
    """What one transaction stores: messages without their ids yet."""

    messages: tuple[ReportMessage, ...]
    reported_until: datetime
    closes: bool = False

    @property
    def passes(self) -> int:
        return sum(len(message.passes) for message in self.messages)


@dataclass(slots=True)
class _Group:
    """Passes that ended under one verdict on the filter's health."""

    health: Health
    passes: list[PassReport] = field(default_factory=list)


class Reporter:
    """Group passes into messages and store them in the outbox from a thread of its own.

    The filter's thread only appends to a list in memory. Where a message ends depends on drive time and on the passes
    alone, never on the pace of the disk, so that driving a log again gives the same messages.

    Parameters
    ----------
    outbox : where the messages go.
    template : the message that says all but the passes, ids and health.
    policy : how passes are grouped.
    """

    def __init__(self, outbox: Outbox, template: ReportMessage, policy: ReportPolicy) -> None:
        self._outbox, self._template, self._policy = outbox, template, policy
        state = outbox.session(template.session_id)
        self._reported_until = state.reported_until
        self._groups: list[_Group] = []
        self._first_at: float | None = None
        self._drafts: deque[_Draft] = deque()
        self._waiting_passes = 0
        self._changed = threading.Condition()
        self._stopping = False
        self._error: OutboxError | None = None  # why the outbox does not take the draft in front
        self._refusal: SlamcuError | None = None  # why a draft was given up
        self.reported = 0  # passes handed to the outbox
        self.repeated = 0  # passes that a run before this one has reported
        self.unusable = 0  # passes that no server would take
        self.dropped = 0  # passes given up because the disk did not take them for too long
        self._thread = threading.Thread(target=self._store_drafts, name="slamcu-reporter", daemon=True)
        self._thread.start()

    def add(self, passes: Sequence[PassReport], health: Health, t: float, now: datetime) -> None:
        """Take passes that ended at drive time `t` (s), which is the instant `now`."""
        if not passes:
            return
        if self._reported_until is not None and now <= self._reported_until:
            # a run that was cut short has stored them: this is the same drive again, or a clock set back
            self.repeated += len(passes)
            return
        self._collect(passes, health)
        if self._groups and self._first_at is None:
            self._first_at = t

    def _collect(self, passes: Sequence[PassReport], health: Health) -> None:
        for report in passes:
            try:
                sent = sendable(report)
            except WireError as error:
                # the server would refuse the whole message for it
                _log.warning("a pass cannot be reported: %s", error)
                self.unusable += 1
                continue
            last = self._groups[-1] if self._groups else None
            # a message carries one verdict on the filter: what a lost one saw must not taint the rest
            if last is None or last.health.trusted != health.trusted or len(last.passes) >= self._policy.max_passes:
                last = _Group(health)
                self._groups.append(last)
            last.health = health
            last.passes.append(sent)

    def tick(self, t: float, before: datetime) -> None:
        """Hand on what is due when drive time reaches `t`; `before` is the last instant that is complete."""
        if self._first_at is None:
            return
        waiting = sum(len(group.passes) for group in self._groups)
        if t - self._first_at >= self._policy.interval_s or waiting >= self._policy.max_passes:
            self._hand_on(before)

    def finish(self, passes: Sequence[PassReport], health: Health, until: datetime, timeout_s: float) -> None:
        """Take the passes that the end of the drive ended, mark the session as over, and wait until all is on disk.

        Raises OutboxError if that did not succeed within `timeout_s`, and the reason if a message was refused.
        """
        self._collect(passes, health)
        if not self._groups:
            self._groups.append(_Group(health))
        self._hand_on(until, closes=True)
        self._drain(timeout_s)

    def abandon(self, timeout_s: float) -> None:
        """Stop without the mark: what was handed on is stored, the passes still held back are not reported."""
        self._groups, self._first_at = [], None
        self._drain(timeout_s)

    def _hand_on(self, until: datetime, *, closes: bool = False) -> None:
        messages = [replace(self._template, passes=tuple(group.passes), health=group.health) for group in self._groups]
        self._groups, self._first_at = [], None
        if closes:
            messages[-1] = replace(messages[-1], last_of_session=True)
        draft = _Draft(tuple(messages), until, closes)
        with self._changed:
            self._drafts.append(draft)
            self._waiting_passes += draft.passes
            # the one in front is being stored: it stays
            while self._waiting_passes > self._policy.max_waiting_passes and len(self._drafts) > 2:
                given_up = self._drafts[1]
                del self._drafts[1]
                self._waiting_passes -= given_up.passes
                self.dropped += given_up.passes
            self._changed.notify_all()

    def wait_stored(self, timeout_s: float) -> bool:
        """Wait until all that was handed on is on disk; False if time ran out."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._drafts, timeout_s)

    def _drain(self, timeout_s: float) -> None:
        stored = self.wait_stored(timeout_s)
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
            error, left = self._error, self._waiting_passes
        if not stored:
            raise OutboxError(
                f"{left} passes could not be stored within {timeout_s:g} s ({error or 'no answer'})"
            ) from error
        self._thread.join()
        if self._refusal is not None:
            raise self._refusal

    def _store_drafts(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._drafts or self._stopping)
                if not self._drafts:
                    return
                draft = self._drafts[0]
            try:
                self._outbox.put(
                    self._template.session_id,
                    [_encoder(message) for message in draft.messages],
                    reported_until=draft.reported_until,
                    closes=draft.closes,
                )
            except OutboxError as error:
                # the disk may have room again later; until then memory holds what it is allowed to
                with self._changed:
                    self._error = error
                    if self._stopping:
                        return
                    self._changed.wait(_RETRY_S)
                continue
            except SlamcuError as error:
                # no later attempt would fare better: give the draft up, count it, and let close() tell
                self._forget(draft, given_up=error)
            else:
                self._forget(draft)

    def _forget(self, draft: _Draft, given_up: SlamcuError | None = None) -> None:
        with self._changed:
            self._drafts.popleft()
            self._waiting_passes -= draft.passes
            if given_up is None:
                self.reported += draft.passes
                self._error = None
            else:
                self.dropped += draft.passes
                self._refusal = given_up
            self._changed.notify_all()


def _encoder(message: ReportMessage) -> Encode:
    return lambda message_id: serialize_message(replace(message, message_id=message_id))
