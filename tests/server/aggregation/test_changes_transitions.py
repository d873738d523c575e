"""The rules of the feed, one by one."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import ClassPolicy
from slamcu_server.changes.belief import Belief, Kind, State, Subject
from slamcu_server.changes.document import claim_document, ellipse95
from slamcu_server.changes.transitions import Claim, Published, Transition, Voice, decide, is_material

RULES = ClassPolicy(enter=0.8)
NOW = datetime(2026, 5, 1, tzinfo=UTC)


def belief(**changes: Any) -> Belief:
    made = Belief(
        kind=Kind.NEW,
        weight_for=2.0,
        weight_against=0.0,
        standing=True,
        stood_since=NOW,
        contributors_for=2,
        contributors_against=0,
        passes=2,
        first_seen=NOW,
        last_seen=NOW,
        last_looked=NOW,
        last_informative=NOW,
        feature_class="traffic_sign",
        sign="STOP_SIGN",
        value=None,
        lon=2.1,
        lat=48.9,
        covariance_m2=(0.25, 0.0, 0.25),
        policy_version="v",
    )
    return replace(made, **changes)


def claim(made: Belief) -> Claim:
    voice = Voice(Subject(Kind.NEW, 1, candidate_id=1), made, made.standing, made.mass)
    return Claim(Kind.NEW, standing=made.standing, candidate=voice)


def published(state: State, before: Belief | None = None, **changes: Any) -> Published:
    document = claim_document(claim(before or belief()), "m", None)
    return Published(1, 1, Kind.NEW, state, 3, document, candidate_id=1, **changes)


@pytest.mark.parametrize(
    ("now", "before", "expected"),
    [
        (belief(), None, Transition(State.CONFIRMED, opens=True)),
        (belief(standing=False, weight_for=1.0), None, Transition(State.CANDIDATE, opens=True)),
        (belief(standing=False, weight_for=0.3), None, None),
        (belief(), published(State.CANDIDATE), Transition(State.CONFIRMED, opens=False)),
        (belief(standing=False), published(State.CANDIDATE), None),
        (belief(standing=False, weight_for=0.1), published(State.CANDIDATE), Transition(State.WITHDRAWN, opens=False)),
        (belief(standing=False), published(State.CONFIRMED), Transition(State.WITHDRAWN, opens=False)),
        (belief(), published(State.CONFIRMED), None),
        (belief(), published(State.WITHDRAWN), Transition(State.CONFIRMED, opens=False)),
        (belief(standing=False), published(State.WITHDRAWN), None),
        (belief(), published(State.REJECTED), None),
        (belief(standing=False), published(State.REJECTED), None),
        (belief(), published(State.REJECTED, evidence_left=True), Transition(State.CONFIRMED, opens=True)),
        (belief(), published(State.ACCEPTED), Transition(State.CONFIRMED, opens=True)),
        (belief(standing=False), published(State.ACCEPTED), None),
        (belief(), published(State.ABSORBED), Transition(State.CONFIRMED, opens=True)),
        (belief(), published(State.CONTRADICTED), None),
        (belief(), published(State.CONTRADICTED, evidence_left=True), Transition(State.CONFIRMED, opens=True)),
    ],
)
def test_what_is_said_next(now: Belief, before: Published | None, expected: Transition | None) -> None:
    assert decide(claim(now), before, RULES) == expected


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, False),
        ({"contributors_for": 3}, True),
        ({"contributors_against": 1}, True),
        ({"passes": 50, "weight_for": 9.0}, False),
        ({"lat": 48.9 + 0.10 / 111_200}, False),  # 0.2 of its standard deviation
        ({"lat": 48.9 + 0.20 / 111_200}, True),
        ({"lon": 2.1 + 0.10 / 73_000}, False),
        ({"lon": 2.1 + 0.20 / 73_000}, True),
    ],
)
def test_a_confirmed_change_is_said_again_when_it_matters(changes: dict[str, Any], said: bool) -> None:
    assert (decide(claim(belief(**changes)), published(State.CONFIRMED), RULES) is not None) is said


@pytest.mark.parametrize(
    ("now", "said"),
    [((2.1, 48.9), False), ((2.1, 48.9 + 0.02 / 111_200), True), ((2.1, 48.9 + 0.001 / 111_200), False)],
)
def test_a_place_that_the_map_knows_exactly_moves_when_the_map_moves_it(now: tuple[float, float], said: bool) -> None:
    exact = belief(covariance_m2=(0.0, 0.0, 0.0))
    moved = replace(exact, lon=now[0], lat=now[1])
    assert (decide(claim(moved), published(State.CONFIRMED, exact), RULES) is not None) is said


def test_the_other_side_of_the_antimeridian_is_near() -> None:
    before = published(State.CONFIRMED, belief(lon=-180.0))
    assert decide(claim(belief(lon=180.0 - 0.10 / 73_000)), before, RULES) is None
    assert decide(claim(belief(lon=180.0 - 0.20 / 73_000)), before, RULES) is not None


def test_one_vehicle_more_of_many_is_no_news() -> None:
    many = published(State.CONFIRMED, belief(contributors_for=20))
    assert decide(claim(belief(contributors_for=21)), many, RULES) is None
    assert decide(claim(belief(contributors_for=25)), many, RULES) is not None


@given(st.floats(0.01, 10.0), st.floats(0.01, 10.0), st.floats(-0.99, 0.99))
def test_the_ellipse_holds_95_per_cent(east: float, north: float, correlation: float) -> None:
    covariance = (east**2, correlation * east * north, north**2)
    ellipse = ellipse95(covariance)
    assert ellipse["semi_major_m"] >= ellipse["semi_minor_m"] >= 0.0
    assert 0.0 <= ellipse["orientation_deg"] <= 180.0
    area = np.pi * ellipse["semi_major_m"] * ellipse["semi_minor_m"]
    determinant = covariance[0] * covariance[2] - covariance[1] ** 2
    assert area == pytest.approx(np.pi * 5.991464547 * np.sqrt(determinant), rel=1e-6)


def test_the_ellipse_points_where_the_place_is_vague() -> None:
    assert ellipse95((4.0, 0.0, 1.0))["orientation_deg"] == pytest.approx(90.0)
    assert ellipse95((1.0, 0.0, 4.0))["orientation_deg"] == pytest.approx(0.0)
    assert ellipse95((1.0, 0.9, 1.0))["orientation_deg"] == pytest.approx(45.0)


def moved(feature: Belief, candidate: Belief) -> Claim:
    """A claim that what stood in one place stands in another."""
    gone = Voice(Subject(Kind.DELETED, 1, feature_id=7, map_object_id=7), feature, standing=True, mass=0.9)
    there = Voice(Subject(Kind.NEW, 1, candidate_id=1), candidate, standing=True, mass=0.9)
    return Claim(Kind.MOVED, standing=True, feature=gone, candidate=there)


@pytest.mark.parametrize(
    ("feature", "candidate", "said"),
    [
        ({}, {}, False),
        ({"contributors_against": 4}, {}, True),  # of the old place
        ({"contributors_for": 1}, {}, True),
        ({}, {"contributors_for": 3}, True),  # of the new one
        ({}, {"lat": 48.9 + 0.20 / 111_200}, True),
    ],
)
def test_a_change_with_two_ends_is_said_again_when_either_matters(
    feature: dict[str, Any], candidate: dict[str, Any], said: bool
) -> None:
    old = belief(kind=Kind.DELETED, weight_for=0.0, weight_against=2.0, contributors_for=0, contributors_against=3)
    document = claim_document(moved(old, belief()), "m", None)
    before = Published(1, 1, Kind.MOVED, State.CONFIRMED, 3, document, feature_id=7, candidate_id=1)
    now = moved(replace(old, **feature), belief(**candidate))
    assert (decide(now, before, RULES) is not None) is said


def test_a_document_that_lacks_the_old_place_no_longer_tells_all() -> None:
    old = belief(kind=Kind.DELETED, weight_for=0.0, weight_against=2.0)
    claimed = moved(old, belief())
    document = claim_document(claimed, "m", None)
    assert not is_material(claimed, document)
    assert is_material(claimed, document | {"from": None})
