"""An outbox that remembers what went through it: what a vehicle told the cloud, as the cloud will read it."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from slamcu_client import Outbox
from slamcu_client.outbox import Encode
from slamcu_core.reports import ReportMessage
from slamcu_core.sensoris import decode_message


class WitnessedOutbox(Outbox):
    """An outbox whose messages stay readable in `messages` after the server has taken them."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.messages: list[ReportMessage] = []

    def put(
        self,
        session_id: str,
        encoders: Sequence[Encode],
        *,
        reported_until: datetime | None = None,
        closes: bool = False,
    ) -> list[int]:
        """Store messages as any outbox, and remember them."""
        ids = super().put(session_id, encoders, reported_until=reported_until, closes=closes)
        self.messages += [decode_message(encode(one)) for encode, one in zip(encoders, ids, strict=True)]
        return ids
