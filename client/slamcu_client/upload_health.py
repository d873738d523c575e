"""How an upload fares, for the software of the car to look at while it drives, and what it has achieved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Self

from slamcu_client.received import one_line


@dataclass(frozen=True, slots=True)
class UploadResult:
    """What a `flush` achieved."""

    accepted: int = 0
    duplicates: int = 0  # the server had them already: an answer was lost on the way
    rejected: int = 0
    remaining: int = 0  # still in the outbox


@dataclass(frozen=True, slots=True)
class UploadHealth:
    """Whether messages get through, and what kept them back last."""

    failing: bool = False  # the newest attempt failed; False before the first
    refused: bool = False  # and will not be repeated: the server itself refuses the vehicle or the request
    failures: int = 0  # attempts that failed, in all
    unexpected: int = 0  # of them, those that nobody foresaw; the log has their tracebacks
    strangers: int = 0  # answers in a row that no slamcu server gave: of a hotspot, or the address is wrong
    last_failure: str = ""  # what happened, in one line for people; kept when a later attempt succeeds
    last_failure_at: datetime | None = None

    def after_success(self) -> Self:
        """Return the health after an attempt that was answered as hoped."""
        return replace(self, failing=False, refused=False, strangers=0)

    def after_failure(
        self, what: str, *, refused: bool = False, unexpected: bool = False, own: bool | None = None
    ) -> Self:
        """Return the health after an attempt that failed; `own`: a slamcu server answered it (None: nobody did)."""
        return replace(
            self,
            failing=True,
            refused=refused,
            failures=self.failures + 1,
            unexpected=self.unexpected + unexpected,
            strangers=self.strangers if own is None else 0 if own else self.strangers + 1,
            last_failure=one_line(what),
            last_failure_at=datetime.now(UTC),
        )
