"""Dempster-Shafer evidence about existence: the paper's section 4.2 in weights of evidence."""

from slamcu_core.evidence.dempster import conjunctive, dempster
from slamcu_core.evidence.masses import Existence, Masses, discount
from slamcu_core.evidence.weights import (
    LAMBDA_MAX,
    LN_2,
    clamp_confidence,
    conflict,
    masses_from_weights,
    support,
    support_of,
    weights_from_masses,
)

__all__ = [
    "LAMBDA_MAX",
    "LN_2",
    "Existence",
    "Masses",
    "clamp_confidence",
    "conflict",
    "conjunctive",
    "dempster",
    "discount",
    "masses_from_weights",
    "support",
    "support_of",
    "weights_from_masses",
]
