"""The uploader: carries messages from the outbox to the server until each is acknowledged."""

from __future__ import annotations

import gzip
import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from slamcu_client.errors import AnswerError, ClientError, OutboxError, TransportError
from slamcu_client.outbox import MessageKey, Outbox, OutboxMessage
from slamcu_client.receipt import Receipt, read_receipt
from slamcu_client.retry import Failure, RetryDecision, RetryPolicy, retry_decision
from slamcu_client.server import Server, describe, is_own_problem, refuse_unauthorized, unexpected
from slamcu_client.transport import Request, Response
from slamcu_client.upload_health import UploadHealth, UploadResult
from slamcu_core.sensoris import join_batch

_PATH = "/v1/data-messages"
CONFLICT = "conflicting-bytes"  # what the server calls a message whose ids it has seen with other bytes
# what a server that trips over one message says, or a proxy that dislikes one, or their number
_OVER_CONTENT = frozenset({400, 403, 413, 422, 500})
_DISK_RETRY_S = 1.0  # as the reporter has it
_STRANGERS_WARNED_OF = 5  # answers in a row: half a minute, by when a hotspot is left behind
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class UploadPolicy:
    """How large batches are and how patient the uploader is."""

    max_messages: int = 100  # per request
    max_bytes: int = 512 * 1024  # per request, before compression
    feel_ahead: bool = False  # one message a request until the server has taken one that it did not know
    idle_s: float = 2.0  # how often an empty outbox is looked at
    leave_s: float = 2.0  # how long the end of `in_background` waits for an exchange under way
    failures_before_put_off: int = 3  # answers over one message before others go first
    retry: RetryPolicy = field(default_factory=RetryPolicy)


class Uploader:
    """Send what waits in an outbox, in batches, until the server has taken it.

    Nothing is lost: a message leaves the outbox only when the server has named it accepted, duplicate or rejected.
    Nothing is doubled: a message that may have arrived is sent again as the same bytes under the same ids, and the
    server knows it. A message that the server rejects does not hold up the others, unless it has the ids of another:
    then somebody else has reported that session, and what else waits of it is rejected too, without being sent.

    ::

        uploader = Uploader(outbox, Server("https://slamcu.example", api_key))
        uploader.flush(timeout_s=60)           # blocks until the outbox is empty or the time is up
        with uploader.in_background():         # or beside the drive
            ...

    Parameters
    ----------
    outbox : where the messages wait.
    server : where they go.
    policy : sizes and patience.
    rng : the source of the jitter in waits.
    """

    def __init__(
        self,
        outbox: Outbox,
        server: Server,
        policy: UploadPolicy = UploadPolicy(),
        *,
        rng: np.random.Generator | None = None,
    ) -> None:
        self._outbox, self._server, self._policy = outbox, server, policy
        self._rng = np.random.default_rng() if rng is None else rng
        self._feeling = policy.feel_ahead
        self._batch_limit = 1 if self._feeling else policy.max_messages
        self._contradicted: set[str] = set()  # sessions of which the server knows other messages under the same ids
        self._failures = 0  # in a row
        self._server_errors = 0  # in a row over one and the same message
        self._accepted = self._duplicates = self._rejected = 0
        self._health = UploadHealth()
        # what the server has settled and the disk has not taken yet: not to be sent again each second
        self._unrecorded: tuple[list[MessageKey], list[tuple[MessageKey, str, str]]] | None = None
        self._one_at_a_time = threading.Lock()

    @property
    def result(self) -> UploadResult:
        """What this uploader has achieved since it was made."""
        return UploadResult(self._accepted, self._duplicates, self._rejected, self._outbox.stats().pending)

    @property
    def contradicted(self) -> frozenset[str]:
        """Sessions of which the server has other messages under the same ids: nothing more of them is sent."""
        return frozenset(self._contradicted)

    @property
    def health(self) -> UploadHealth:
        """Whether messages get through now, and what kept them back last."""
        return self._health

    def run(self, stop: threading.Event) -> None:
        """Upload until `stop` is set, whatever the network does meanwhile: what fails is tried again; see `health`.

        A disk that fails is waited for likewise. Raises AuthenticationError or another AnswerError if the server itself
        refuses the vehicle or the request; what waits stays in the outbox.
        """
        while not stop.is_set():
            wait_s = self._step()
            if wait_s is None:
                wait_s = self._policy.idle_s
            if wait_s:
                stop.wait(wait_s)

    def flush(self, timeout_s: float) -> UploadResult:
        """Upload until the outbox is empty, or until the next attempt would be due after `timeout_s`.

        An exchange under way is not cut short, so this may take somewhat longer. Raises as `run` does, and OutboxError
        if not even what remains can be read at the end.
        """
        deadline = time.monotonic() + timeout_s
        while (wait_s := self._step(max(deadline - time.monotonic(), 0.0))) is not None:
            if time.monotonic() + wait_s >= deadline:
                break
            time.sleep(wait_s)
        return self.result

    @contextmanager
    def in_background(self) -> Iterator[None]:
        """Upload in a thread while the block runs, and raise at its end what stopped the thread before.

        The end of the block waits at most `policy.leave_s` for an exchange under way. What that does not settle stays
        in the outbox and is sent again next time; the server knows it then if it has arrived.
        """
        stop = threading.Event()
        errors: list[ClientError] = []

        def work() -> None:
            try:
                self.run(stop)
            except ClientError as error:
                _log.error("the upload has stopped: %s", error)
                errors.append(error)

        thread = threading.Thread(target=work, name="slamcu-uploader", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join(self._policy.leave_s)
            if thread.is_alive():
                _log.info("an exchange is still under way; what it does not settle is sent again next time")
        if errors:
            raise errors[0]

    # --- one batch --------------------------------------------------------------------------------------------------

    def _step(self, patience_s: float = -1.0) -> float | None:
        """Send one batch; return the seconds to wait before the next, or None if there is nothing to send.

        Wait for an exchange in another thread for `patience_s` at most (-1: until it is over), then do nothing.
        """
        if not self._one_at_a_time.acquire(timeout=patience_s):
            return 0.0
        try:
            return self._guarded()
        finally:
            self._one_at_a_time.release()

    def _guarded(self) -> float | None:
        """Send one batch; whatever fails is a wait, unless the server itself refuses."""
        try:
            return self._send()
        except AnswerError as error:
            self._health = self._health.after_failure(str(error), refused=True)
            raise
        except OutboxError as error:
            # the disk may have room again in a moment
            if not self._health.failing:
                _log.warning("the upload waits for the disk: %s", error)
            self._health = self._health.after_failure(str(error))
            return _DISK_RETRY_S
        except Exception as error:  # noqa: BLE001  (nothing that one answer brings about may end the thread)
            _log.exception("the upload failed unexpectedly and will be tried again")
            self._health = self._health.after_failure(f"{type(error).__name__}: {error}", unexpected=True)
            return self._decide(Failure()).wait_s

    def _send(self) -> float | None:
        self._record()
        batch = self._outbox.pending(self._batch_limit, self._policy.max_bytes)
        if not batch:
            return None
        if astray := [message.key for message in batch if message.key.session_id in self._contradicted]:
            detail = "an earlier message of its session has the ids of another"
            self._outbox.settle((), [(key, CONFLICT, detail) for key in astray])
            self._rejected += len(astray)
            return 0.0
        try:
            self._outbox.attempt(message.key for message in batch)
        except OutboxError as error:
            # sent all the same: the ids keep it from counting twice, and reading may work where writing does not
            _log.info("%s", error)
        try:
            request, response = self._server.exchange(
                "POST",
                _PATH,
                headers={
                    "Content-Type": "application/x-protobuf",
                    "Content-Encoding": "gzip",
                    "Accept": "application/json",
                },
                content=gzip.compress(join_batch([message.body for message in batch]), 6, mtime=0),
            )
        except TransportError as error:
            _log.info("%s", error)
            self._health = self._health.after_failure(str(error))
            return self._decide(Failure(fault=error.fault)).wait_s
        receipt = read_receipt(response, len(batch))
        if receipt is not None:
            self._settle(batch, receipt)
            return 0.0
        return self._refused(batch, request, response)

    def _settle(self, batch: list[OutboxMessage], receipt: Receipt) -> None:
        bad = {index for index, _, _ in receipt.rejected}
        self._unrecorded = (
            [message.key for index, message in enumerate(batch) if index not in bad],
            [(batch[index].key, reason, detail) for index, reason, detail in receipt.rejected],
        )
        for index, reason, detail in receipt.rejected:
            key = batch[index].key
            _log.warning("the server rejected message %d of %s: %s %s", key.message_id, key.session_id, reason, detail)
            if reason == CONFLICT:
                self._contradicted.add(key.session_id)
        self._accepted += receipt.accepted
        self._duplicates += receipt.duplicates
        self._rejected += len(receipt.rejected)
        self._failures = self._server_errors = 0
        self._feeling = self._feeling and not receipt.accepted
        if not self._feeling:
            # grow slowly: twice the size would run into the same 413 again and again
            self._batch_limit = min(self._batch_limit + self._batch_limit // 8 + 1, self._policy.max_messages)
        self._record()

    def _record(self) -> None:
        """Write down what the server has settled; until the disk takes it, nothing else is sent."""
        if self._unrecorded is not None:
            settled, self._unrecorded = self._unrecorded, None
            try:
                self._outbox.settle(*settled)
            except OutboxError:
                self._unrecorded = settled
                raise
            self._health = self._health.after_success()

    def _refused(self, batch: list[OutboxMessage], request: Request, response: Response) -> float:
        """Act on an answer that settles nothing; return the seconds to wait."""
        refuse_unauthorized(request, response)
        _log.info("%s %s: %s", request.method, request.url, describe(response))
        own = is_own_problem(response)
        # 413: too much at once. 400, 422: one bad message spoils the batch
        if own and response.status in {400, 413, 422}:
            if len(batch) > 1:
                self._batch_limit = len(batch) // 2
            else:
                reason = "too-large" if response.status == 413 else "refused"
                self._settle(batch, Receipt(0, 0, ((0, reason, describe(response)),)))
            return 0.0
        if response.status in _OVER_CONTENT:
            self._isolate(batch)
        retry_after = response.headers.get("retry-after")
        decision = self._decide(Failure(status=response.status, retry_after=retry_after, own=own))
        if not decision.retriable:
            raise unexpected(request, response)
        self._health = self._health.after_failure(describe(response), own=own)
        if not own and self._health.strangers == _STRANGERS_WARNED_OF:
            question = "%d answers in a row came from no slamcu server: is %s its address? (%s)"
            _log.warning(question, _STRANGERS_WARNED_OF, self._server.url, describe(response))
        return decision.wait_s

    def _isolate(self, batch: list[OutboxMessage]) -> None:
        """Close in on the one message that somebody may be failing over, and let the others go before it."""
        if len(batch) > 1:
            self._batch_limit = len(batch) // 2
            return
        self._server_errors += 1
        if self._server_errors >= self._policy.failures_before_put_off:
            self._outbox.put_off(batch[0].key)
            self._server_errors = 0

    def _decide(self, failure: Failure) -> RetryDecision:
        self._failures += 1
        return retry_decision(failure, self._failures, rng=self._rng, now=datetime.now(UTC), policy=self._policy.retry)
