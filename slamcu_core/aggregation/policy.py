"""The parameters of the cloud's evidence law, per feature class, as a document with a version.

The defaults are chosen from the curves of `slamcu-eval law`, which docs/fleet.md holds: false changes against passes to
a decision, beside the least delay possible. At 5 % misses and a threshold of 0.8 four unanimous misses delete a fresh
feature; three (0.794 at α 0.7, γ 0.8) would be wrong three times as often while a map is fresh, and would save no pass
once a feature has been confirmed. `tests/core/test_aggregation_regime.py` keeps the defaults to their goals.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from slamcu_core.aggregation.trust import Trusts
from slamcu_core.errors import EvidenceError

_COUNTS = frozenset(
    {
        "contributors_new",
        "contributors_deleted",
        "contributors_leave",
        "contributors_in_doubt",
        "pair_patience",
        "strangers_more",
        "window",
    }
)
_MOST: Mapping[str, float] = {
    **dict.fromkeys(_COUNTS - {"window"}, 1_000),
    "window": 10_000,
    "half_life_days": 1e9,
    "contributor_weight": 1_000.0,  # the most that a pass may weigh
    "gate": 1_000.0,
    "position_floor_m": 100.0,  # a place vaguer than that is none
    "position_common_m": 100.0,
    "match_radius_m": 1_000.0,
    "pair_radius_m": 1_000.0,  # a batch locks what is so near
    "pair_lateral_m": 1_000.0,
    "pair_days": 1e5,
}
_MAY_BE_NONE = frozenset({"strangers_more", "contributors_in_doubt"})


@dataclass(frozen=True, slots=True)
class ClassPolicy:
    """Parameters of the law for one class of features (design, section 2, unless another source is named).

    Raises EvidenceError naming the field that is out of its range.
    """

    trust: float = 0.7  # α in (0, 1), of a contributor of whom nothing else is known
    # α in (0, 1) at which misses are told, if above `trust`, of what one contributor alone has seen: that cannot stand,
    # so nobody gains by lying about it, and of honest misses 5 % are wrong
    trust_against_one: float = 0.95
    forgetting: float = 0.8  # γ in (0, 1), what a fully informative contribution leaves of the older evidence
    half_life_days: float = 180.0  # days until unrefreshed weights have halved, applied when reading
    enter: float = 0.8  # mass in (0.5, 1) from which a change stands
    leave: float = 0.5  # mass in (0, enter) below which it stands no longer
    contributors_new: int = 2  # least number of contributors whose evidence for a new feature still weighs
    contributors_deleted: int = 3  # the same for evidence against a mapped feature
    contributors_leave: int = 2  # the same for evidence that makes what stands stand no longer
    # how many more than each of these it takes, if above 1, where none of them has a record; 0: none is a stranger
    strangers_more: int = 1
    # how many of those who said that they are not to be trusted have to agree for their word to count, to the quorums
    # as that of strangers; 0: it never does
    contributors_in_doubt: int = 4
    contributor_weight: float = 0.1  # weight of evidence that a contributor must have left in the fold to be counted
    window: int = 64  # K, newest informative contributions that fold: 0.8⁶⁴ = 6e-7
    minimum_informativeness: float = 0.05  # w in [0, 1) below which a contribution has seen nothing
    gate: float = 9.21  # chi-square threshold with 2 degrees of freedom; 9.21 keeps 99 %
    position_floor_m: float = 0.35  # m per axis, 1 σ: bias common to one vehicle's passes (1.5 % range bias at 25 m)
    position_common_m: float = 0.1  # m per axis, 1 σ: what all cars have wrong together, as the map around a place does
    match_radius_m: float = 5.0  # m beyond which two places are never one object, however vague they are
    pair_radius_m: float = 30.0  # m within which a deleted and a new one of the same type are one that moved
    pair_lateral_m: float = 8.0  # m of that across the way it faces: on the other side of the road is another one
    pair_days: float = 30.0  # days between the turn of evidence about the old place and the first find at the new one
    pair_patience: int = 6  # contributors for a new one from which it waits no more for a deletion under way nearby

    # What is known of contributors, no parameter and in no document; None: all count as if they had a record.
    trusts: Trusts | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        for name in _PARAMETERS:
            value = getattr(self, name)
            if name in _COUNTS:
                least = 0 if name in _MAY_BE_NONE else 1
                _require(
                    isinstance(value, int) and not isinstance(value, bool) and value >= least,
                    name,
                    value,
                    f"a whole number from {least}",
                )
            else:
                _require(
                    isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value),
                    name,
                    value,
                    "a finite number",
                )
                object.__setattr__(self, name, float(value))
        for name in ("trust", "trust_against_one", "forgetting"):
            _require(0.0 < getattr(self, name) < 1.0, name, getattr(self, name), "within (0, 1)")
        _require(0.5 < self.enter < 1.0, "enter", self.enter, "within (0.5, 1)")
        _require(0.0 < self.leave < self.enter, "leave", self.leave, f"within (0, enter = {self.enter})")
        _require(
            0.0 <= self.minimum_informativeness < 1.0,
            "minimum_informativeness",
            self.minimum_informativeness,
            "within [0, 1)",
        )
        for name in (
            "half_life_days",
            "contributor_weight",
            "gate",
            "position_floor_m",
            "match_radius_m",
            "pair_lateral_m",
            "pair_days",
        ):
            _require(getattr(self, name) > 0.0, name, getattr(self, name), "above 0")
        for name, most in _MOST.items():
            _require(getattr(self, name) <= most, name, getattr(self, name), f"at most {most:,g}")
        _require(self.position_common_m >= 0.0, "position_common_m", self.position_common_m, "at least 0")
        _require(
            self.pair_radius_m >= self.match_radius_m,
            "pair_radius_m",
            self.pair_radius_m,
            f"at least match_radius_m = {self.match_radius_m}",
        )

    def to_document(self) -> dict[str, Any]:
        """Return the parameters as a document fit for JSON, every one written out."""
        return {name: getattr(self, name) for name in _PARAMETERS}

    @property
    def opening_mass(self) -> float:
        """The mass from which a change is spoken of: half of what makes it stand."""
        return 0.5 * self.enter

    @property
    def closing_mass(self) -> float:
        """The mass below which a change that was spoken of, and never stood, is dropped: half of that again."""
        return 0.25 * self.enter


_PARAMETERS = tuple(spec.name for spec in dataclasses.fields(ClassPolicy) if spec.name != "trusts")


@dataclass(frozen=True)
class Policy:
    """The parameters of every class: a default, and classes that differ from it."""

    default: ClassPolicy = field(default_factory=ClassPolicy)
    classes: Mapping[str, ClassPolicy] = field(default_factory=dict)

    def for_class(self, name: str) -> ClassPolicy:
        """Return the parameters of a feature class."""
        return self.classes.get(name, self.default)

    @property
    def reach_m(self) -> float:
        """The farthest in metres that one pass can matter for the cluster of another: the largest match radius."""
        return max(policy.match_radius_m for policy in (self.default, *self.classes.values()))

    @property
    def lock_reach_m(self) -> float:
        """The farthest in metres that a pass or belief can matter for another: the largest pairing radius."""
        return max(policy.pair_radius_m for policy in (self.default, *self.classes.values()))

    def trusting(self, trusts: Trusts | None) -> Policy:
        """Return the same policy with what is known of contributors."""
        return Policy(
            dataclasses.replace(self.default, trusts=trusts),
            {name: dataclasses.replace(rules, trusts=trusts) for name, rules in self.classes.items()},
        )

    def to_document(self) -> dict[str, Any]:
        """Return the policy as a document fit for JSON, every field written out."""
        return {
            "default": self.default.to_document(),
            "classes": {name: self.classes[name].to_document() for name in sorted(self.classes)},
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Policy:
        """Read a policy; fields that a class leaves out are the default's, and the default's are slamcu's.

        Raises EvidenceError naming the path of an unknown key or a bad value.
        """
        root = _mapping(document, "the policy")
        for key in root:
            _require(key in ("default", "classes"), str(key), root[key], "'default' or 'classes'", unknown=True)
        default = _class_policy(root.get("default", {}), ClassPolicy(), "default")
        classes = _mapping(root.get("classes", {}), "classes")
        return cls(
            default, {str(name): _class_policy(entry, default, f"classes.{name}") for name, entry in classes.items()}
        )

    @cached_property
    def version(self) -> str:
        """The first 12 hexadecimal digits of the SHA-256 of the canonical document."""
        canonical = json.dumps(self.to_document(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()[:12]


def _class_policy(document: object, base: ClassPolicy, path: str) -> ClassPolicy:
    entry = _mapping(document, path)
    known = sorted(_PARAMETERS)
    for key in entry:
        _require(key in known, f"{path}.{key}", entry[key], f"one of {', '.join(known)}", unknown=True)
    try:
        return dataclasses.replace(base, **entry)
    except EvidenceError as error:
        raise EvidenceError(f"{path}.{error}") from error


def _mapping(value: object, path: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise EvidenceError(f"{path} must be an object, not {value!r}")
    return value


def _require(holds: bool, path: str, value: object, expected: str, *, unknown: bool = False) -> None:
    if not holds:
        raise EvidenceError(
            f"{path} is unknown: expected {expected}" if unknown else f"{path} must be {expected}, not {value!r}"
        )
