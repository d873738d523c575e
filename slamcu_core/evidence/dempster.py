"""Dempster's rule as the paper prints it, eq. 5-7: the reference that the weights of evidence are held to.

Errata: eq. 6 divides by 1 - m(∅), which cancels after long runs of agreement; here the three non-empty masses are
divided by their own sum, which is the same number computed safely.
"""

from __future__ import annotations

from slamcu_core.evidence.masses import SMALLEST_UNKNOWN, Masses


def conjunctive(first: Masses, second: Masses) -> tuple[float, float, float, float]:
    """Combine two mass functions by intersection (eq. 7) and return m(∅), m(exists), m(not), m(Ω)."""
    empty = first.exists * second.not_exists + first.not_exists * second.exists
    exists = first.exists * second.exists + first.exists * second.unknown + first.unknown * second.exists
    not_exists = (
        first.not_exists * second.not_exists + first.not_exists * second.unknown + first.unknown * second.not_exists
    )
    return empty, exists, not_exists, first.unknown * second.unknown


def dempster(first: Masses, second: Masses) -> Masses:
    """Combine two independent sources (eq. 5): the conjunctive rule (eq. 7), normalised (eq. 6).

    An unknown mass that leaves the range of a double is held at its smallest.
    """
    _, exists, not_exists, unknown = conjunctive(first, second)
    total = exists + not_exists + unknown
    return Masses(exists / total, not_exists / total, max(unknown / total, SMALLEST_UNKNOWN))
