"""What no camera can have seen: checks of a message against the world instead of against the wire format.

Finds make candidates, every vehicle is told to look for candidates, and all finds near one place are clustered
together: one message must not be able to make thousands of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from slamcu_core.reports import DetectionStatus, PassReport, ReportMessage

FINDS_AT_ONCE = 64
"""Signs that no map has, in view at the same time. Finds seen together are different objects."""

FINDS_AT_ONE_PLACE = 16
"""Finds of one message within some ten metres: as many signs on one gantry, or as many rounds past one sign."""

_CELL_DEG = 1e-4


def implausible(report: ReportMessage) -> str | None:
    """Return what no camera can have seen of what a message says; None if there is nothing."""
    finds = [
        item
        for item in report.passes
        if item.status is DetectionStatus.NOT_EXPECTED_AND_DETECTED and item.reference is None
    ]
    if len(finds) <= FINDS_AT_ONE_PLACE:
        return None
    if (count := _at_once(finds)) > FINDS_AT_ONCE:
        return f"{count} finds in view at the same time, expected at most {FINDS_AT_ONCE}"
    if (count := _at_one_place(finds)) > FINDS_AT_ONE_PLACE:
        return f"{count} finds at one place, expected at most {FINDS_AT_ONE_PLACE} in a message"
    return None


def _at_once(finds: Iterable[PassReport]) -> int:
    edges = [edge for item in finds for edge in ((item.started_at, 0), (item.ended_at, 1))]
    most = now = 0
    for _, ends in sorted(edges):  # who begins when another ends is seen together with it
        now += 1 - 2 * ends
        most = max(most, now)
    return most


def _at_one_place(finds: Iterable[PassReport]) -> int:
    places = Counter(
        (round(item.position.lon / _CELL_DEG), round(item.position.lat / _CELL_DEG))
        for item in finds
        if item.position is not None
    )
    return max(places.values(), default=0)
