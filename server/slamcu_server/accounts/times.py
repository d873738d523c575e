"""When vehicles were where, as it is told: to the hour, for the times of a road's signs in a row are a journey."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from slamcu_core.aggregation import EPOCH_S

_HOUR = timedelta(seconds=EPOCH_S)  # within which what a vehicle says of a thing is one voice: less says nothing more


def hour_of(when: datetime) -> datetime:
    """Return the beginning of the hour that a time (with its zone) lies in."""
    return datetime.fromtimestamp(when.timestamp() // EPOCH_S * EPOCH_S, when.tzinfo)


@dataclass(frozen=True, slots=True)
class TimesTold:
    """How exactly an account is told when vehicles were where, and may ask for it.

    Questions are rounded as answers are: else what is not told could be found by halving.
    """

    exact: bool = False

    def round(self, when: datetime) -> datetime:
        """Return a time as it is told, or as it is compared with what vehicles did."""
        return when if self.exact else hour_of(when)

    def until(self, when: datetime) -> datetime:
        """Return the end of the hour up to which somebody asks."""
        began = self.round(when)
        return when if began == when else began + _HOUR

    def text(self, when: datetime | str | None) -> str | None:
        """Return a time as RFC 3339 text; it may be one already. None stays None."""
        if isinstance(when, str):
            when = datetime.fromisoformat(when)
        return None if when is None else self.round(when).isoformat()
