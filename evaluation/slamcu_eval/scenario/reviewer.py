"""A map provider that trusts the service: it accepts whatever is confirmed."""

from __future__ import annotations

import time
from collections import Counter

from slamcu_eval.fleet import Provider, standing_changes

_POLL_S = 1.0


def accept_confirmed(provider: Provider, map_name: str) -> Counter[str]:
    """Accept every confirmed change of a map, and return how many of each kind."""
    accepted = Counter[str]()
    for change in standing_changes(provider, map_name):
        if change["state"] == "confirmed":
            provider.accept(change["id"])
            accepted[change["kind"]] += 1
    return accepted


def wait_until_quiet(provider: Provider, quiet_s: float) -> int:
    """Wait until the feed has had nothing new for so long, and return the number of its newest entry."""
    last, since = -1, time.monotonic()
    while time.monotonic() - since < quiet_s:
        newest = max((page["last_sequence"] for page in provider.pages("/v1/changes", {"limit": "1000"})), default=0)
        if newest != last:
            last, since = newest, time.monotonic()
        time.sleep(min(_POLL_S, quiet_s))
    return last
