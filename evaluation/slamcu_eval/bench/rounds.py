"""Measure several ways of doing the same work in turn, so that a busy minute troubles all of them alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True, slots=True)
class Rates:
    """The rates of one way of doing the work, one per round."""

    per_round: tuple[float, ...]  # units of work per second

    @property
    def median(self) -> float:
        """The median over the rounds."""
        return median(self.per_round)

    def figures(self) -> dict[str, object]:
        """Return the median and the spread, for people and machines."""
        return {
            "median": self.median,
            "min": min(self.per_round),
            "max": max(self.per_round),
            "rounds": len(self.per_round),
        }


def interleave(ways: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, Rates]:
    """Run every way once a round, each round in the opposite order of the last, and return the rates by way.

    A way does its work once and returns units of work per second. One more round runs first and is not counted.
    """
    names = list(ways)
    measured: dict[str, list[float]] = {name: [] for name in names}
    for number in range(rounds + 1):
        for name in names if number % 2 else reversed(names):
            rate = ways[name]()
            if number:
                measured[name].append(rate)
    return {name: Rates(tuple(rates)) for name, rates in measured.items()}
