"""The mass function on the frame {exists, not}, as one small value."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from slamcu_core.errors import EvidenceError
from slamcu_core.evidence.weights import clamp_confidence, conflict, masses_from_weights, weights_from_masses

SMALLEST_UNKNOWN = 5e-324
"""The smallest mass of the unknown, that of the smallest double: certainty itself would be dogma."""


class Existence(StrEnum):
    """The existence state with the largest mass (paper section 4.3.3)."""

    EXISTENT = "existent"
    NON_EXISTENT = "non_existent"
    TENTATIVE = "tentative"


@dataclass(frozen=True, slots=True)
class Masses:
    """Masses of existence: exists + not_exists + unknown = 1, unknown > 0, m(∅) = 0."""

    exists: float
    not_exists: float
    unknown: float

    def __post_init__(self) -> None:
        weights_from_masses(self.exists, self.not_exists, self.unknown)

    @classmethod
    def detected(cls, confidence: float) -> Masses:
        """Return the masses of a feature in view that was detected (eq. 1), of a map feature at the start (eq. 3)."""
        lam = float(clamp_confidence(confidence))
        return cls(lam, 0.0, 1.0 - lam)

    @classmethod
    def missed(cls, confidence: float) -> Masses:
        """Return the masses of a feature in view that was not detected (eq. 2)."""
        lam = float(clamp_confidence(confidence))
        return cls(0.0, lam, 1.0 - lam)

    @classmethod
    def vacuous(cls) -> Masses:
        """Return the masses of a new feature at the start (eq. 4)."""
        return cls(0.0, 0.0, 1.0)

    @classmethod
    def from_weights(cls, weight_for: float, weight_against: float) -> Masses:
        """Return the masses of weights of evidence f and a.

        Beyond a weight of about 700 the unknown mass leaves the range of a double; it is held at its smallest.
        """
        e, n, u = (float(mass) for mass in masses_from_weights(weight_for, weight_against))
        return cls(e, n, max(u, SMALLEST_UNKNOWN))

    @property
    def weights(self) -> tuple[float, float]:
        """Weights of evidence (f, a)."""
        f, a = weights_from_masses(self.exists, self.not_exists, self.unknown)
        return float(f), float(a)

    @property
    def conflict(self) -> float:
        """Conflict between what speaks for and against, before normalisation."""
        return float(conflict(*self.weights))

    @property
    def state(self) -> Existence:
        """The state with the largest mass (section 4.3.3); a tie is tentative."""
        if self.exists > max(self.not_exists, self.unknown):
            return Existence.EXISTENT
        if self.not_exists > max(self.exists, self.unknown):
            return Existence.NON_EXISTENT
        return Existence.TENTATIVE


def discount(masses: Masses, trust: float) -> Masses:
    """Discount a source by trust α in (0, 1]: (αe, αn, 1 - α + αu)."""
    if not 0.0 < trust <= 1.0:
        raise EvidenceError(f"trust must lie in (0, 1], not {trust}")
    return Masses(trust * masses.exists, trust * masses.not_exists, 1.0 - trust + trust * masses.unknown)
