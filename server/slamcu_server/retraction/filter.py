"""What a retraction names: all that it gives must hold of a pass."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any


@dataclass(frozen=True, slots=True)
class EvidenceFilter:
    """Passes by who reported them, in what session, with what software, and when they ended; None holds of all."""

    contributor_id: int | None = None
    session_id: str | None = None
    fleet_id: str | None = None
    software_version: str | None = None
    event_from: datetime | None = None  # the pass ended at this time or later
    event_until: datetime | None = None  # and before this one

    @property
    def condition(self) -> str:
        """The SQL condition on a pass `p` and its message `m`, with the parameters of `parameters`.

        Only what is given is part of it, so that the planner can use what indexes there are.
        """
        return " AND ".join(_CONDITIONS[name] for name in self.parameters)

    @property
    def parameters(self) -> dict[str, Any]:
        """What is given, by name."""
        return {name: value for name in _CONDITIONS if (value := getattr(self, name)) is not None}


_CONDITIONS = {
    # The message's account is the pass's contributor; the log is indexed by account and session, the passes by message.
    "contributor_id": "m.account_id = :contributor_id",
    "session_id": "m.session_id = :session_id",
    "fleet_id": "p.fleet_id = :fleet_id",
    "software_version": "p.software_version = :software_version",
    "event_from": "p.ended_at >= :event_from",
    "event_until": "p.ended_at < :event_until",
}

FIELDS = tuple(_CONDITIONS)
"""The columns of a retraction that name passes."""
