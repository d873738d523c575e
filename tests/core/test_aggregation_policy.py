"""The policy: legal values only, a document that survives the round trip, and a version that says what it is."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import ClassPolicy, Policy
from slamcu_core.errors import EvidenceError

class_policies = st.builds(
    ClassPolicy,
    trust=st.floats(0.01, 0.99),
    forgetting=st.floats(0.01, 0.99),
    enter=st.floats(0.6, 0.99),
    leave=st.floats(0.01, 0.59),
    window=st.integers(1, 200),
    gate=st.floats(1.0, 20.0),
)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("trust", 0.0),
        ("trust", 1.0),
        ("trust_against_one", 1.0),
        ("forgetting", 1.0),
        ("forgetting", math.nan),
        ("half_life_days", 0.0),
        ("half_life_days", math.inf),
        ("enter", 0.5),
        ("enter", 1.0),
        ("leave", 0.8),
        ("leave", 0.0),
        ("contributors_new", 0),
        ("contributors_deleted", 2.5),
        ("contributor_weight", 0.0),
        ("window", 0),
        ("window", True),
        ("minimum_informativeness", 1.0),
        ("minimum_informativeness", -0.1),
        ("gate", -1.0),
        ("position_floor_m", 0.0),
        ("match_radius_m", "5"),
        ("contributors_leave", 0),
        ("pair_radius_m", 4.0),
        ("pair_days", 0.0),
        ("pair_lateral_m", 0.0),
        ("pair_patience", 1.5),
    ],
)
def test_a_value_out_of_range_is_refused_by_name(field: str, value: object) -> None:
    with pytest.raises(EvidenceError, match=f"^{field} must be"):
        ClassPolicy(**{field: value})  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(EvidenceError, match=rf"^classes\.pole\.{field} must be"):
        Policy.from_document({"classes": {"pole": {field: value}}})


@given(class_policies, st.dictionaries(st.sampled_from(["pole", "traffic_light"]), class_policies))
def test_a_policy_survives_its_document(default: ClassPolicy, classes: dict[str, ClassPolicy]) -> None:
    policy = Policy(default, classes)
    again = Policy.from_document(json.loads(json.dumps(policy.to_document())))
    assert again == policy
    assert again.version == policy.version


def test_a_class_inherits_what_it_leaves_out() -> None:
    policy = Policy.from_document({"default": {"trust": 0.6}, "classes": {"pole": {"match_radius_m": 8}}})
    assert policy.for_class("pole") == ClassPolicy(trust=0.6, match_radius_m=8.0)
    assert policy.for_class("traffic_sign") == ClassPolicy(trust=0.6)
    assert policy.reach_m == 8.0
    assert Policy.from_document({}) == Policy()


@pytest.mark.parametrize(
    ("document", "path"),
    [
        ({"defaults": {}}, "defaults is unknown"),
        ({"default": {"alpha": 0.7}}, r"default\.alpha is unknown"),
        ({"classes": {"pole": {"k": 3}}}, r"classes\.pole\.k is unknown"),
        ({"classes": [1]}, "classes must be an object"),
        ({"classes": {"pole": 0.7}}, r"classes\.pole must be an object"),
        ([], "the policy must be an object"),
    ],
)
def test_a_document_with_faults_is_refused_by_path(document: Any, path: str) -> None:
    with pytest.raises(EvidenceError, match=f"^{path}"):
        Policy.from_document(document)


def test_the_version_follows_the_values_and_nothing_else() -> None:
    pole = ClassPolicy(gate=6.0)
    assert Policy(ClassPolicy(half_life_days=90)).version == Policy(ClassPolicy(half_life_days=90.0)).version
    one = Policy(classes={"pole": pole, "tree": ClassPolicy()})
    assert one.version == Policy(classes={"tree": ClassPolicy(), "pole": pole}).version
    versions = {Policy().version, one.version}
    for name, value in ClassPolicy().to_document().items():
        changed = value + 1 if isinstance(value, int) else value * 1.01
        versions.add(Policy(dataclasses.replace(ClassPolicy(), **{name: changed})).version)
    assert len(versions) == 2 + len(ClassPolicy().to_document())
    assert all(len(version) == 12 and int(version, 16) >= 0 for version in versions)
