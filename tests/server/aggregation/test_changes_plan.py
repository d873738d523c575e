"""Which change goes on with which claim: every change is said at most once at a time."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import Policy
from slamcu_server.changes.belief import Belief, Beliefs, Kind, Pair, State, Subject
from slamcu_server.changes.claims import claims, read
from slamcu_server.changes.plan import Said, plan
from slamcu_server.changes.transitions import Published

POLICY = Policy()
NOW = datetime(2026, 5, 1, tzinfo=UTC)
NOTHING = Beliefs((), {}, frozenset())
OPEN = (State.CANDIDATE, State.CONFIRMED)


def belief(kind: Kind, weight: float, *, standing: bool, contributors: int = 9) -> Belief:
    own, other = (weight, 0.0) if kind is Kind.NEW else (0.0, weight)
    return Belief(
        kind=kind,
        weight_for=own,
        weight_against=other,
        standing=standing,
        stood_since=NOW if standing else None,
        contributors_for=contributors,
        contributors_against=contributors,
        passes=9,
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


def feature(key: int, **changes: Any) -> tuple[Subject, Belief]:
    made = belief(Kind.DELETED, changes.pop("weight", 2.0), standing=changes.pop("standing", True))
    return Subject(Kind.DELETED, 1, feature_id=key, map_object_id=key), replace(made, **changes)


def candidate(key: int, **changes: Any) -> tuple[Subject, Belief]:
    made = belief(Kind.NEW, changes.pop("weight", 2.0), standing=changes.pop("standing", True))
    return Subject(Kind.NEW, 1, candidate_id=key), replace(made, **changes)


def row(key: int, kind: Kind, state: State, feature_id: int | None, candidate_id: int | None, **more: Any) -> Published:
    document = {
        "confirmed_at": None,
        "contributors_for": 9,
        "contributors_against": 9,
        "geometry": {"coordinates": [2.1, 48.9]},
        "covariance_m2": [0.25, 0.0, 0.25],
        **more.pop("document", {}),
    }
    return Published(key, 1, kind, state, 3, document, feature_id, candidate_id, **more)


def said(about: list[tuple[Subject, Belief]], known: list[Published], *pairs: Pair) -> list[Said]:
    beliefs = replace(NOTHING, about=tuple(about), pairs=pairs)
    return plan(claims(read(beliefs, POLICY, {}), pairs, known, POLICY), beliefs, known, POLICY)


def summary(entries: list[Said]) -> list[tuple[int | None, str, State]]:
    return [
        (one.published and one.published.id, (one.claim or one.published).kind.value, one.state)  # type: ignore[union-attr]
        for one in entries
    ]


def test_a_withdrawn_move_comes_back_as_one_of_its_halves_and_the_other_opens() -> None:
    known = [row(1, Kind.MOVED, State.WITHDRAWN, 10, 20)]
    assert summary(said([feature(10), candidate(20)], known)) == [
        (1, "deleted", State.CONFIRMED),
        (None, "new", State.CONFIRMED),
    ]


def test_a_move_that_parts_goes_on_with_what_still_speaks() -> None:
    known = [row(1, Kind.MOVED, State.CONFIRMED, 10, 20)]
    quiet = feature(10, weight=0.1, standing=False)
    assert summary(said([quiet, candidate(20)], known)) == [(1, "new", State.CONFIRMED)]
    assert summary(said([feature(10), candidate(20, weight=0.1, standing=False)], known)) == [
        (1, "deleted", State.CONFIRMED)
    ]
    assert summary(said([quiet, candidate(20, weight=0.1, standing=False)], known)) == [(1, "deleted", State.WITHDRAWN)]


def test_a_half_that_was_rejected_leaves_the_other_to_itself() -> None:
    pair = Pair(Kind.MOVED, 10, 20)
    rejected = row(1, Kind.DELETED, State.REJECTED, 10, None)
    assert summary(said([feature(10), candidate(20)], [rejected], pair)) == [(None, "new", State.CONFIRMED)]
    left = replace(rejected, evidence_left=True)
    assert summary(said([feature(10), candidate(20)], [left], pair)) == [(None, "moved", State.CONFIRMED)]


@pytest.mark.parametrize(
    ("contributors", "metres", "kind", "state"),
    [
        (2, 9.0, "moved", State.CANDIDATE),
        (6, 9.0, "new", State.CONFIRMED),
        (6, 4.5, "moved", State.CANDIDATE),  # in the same place it is no second one
    ],
)
def test_a_new_half_waits_for_so_many(contributors: int, metres: float, kind: str, state: State) -> None:
    there = {"lat": 48.9 + metres / 111_200.0}
    about = [feature(10, weight=0.9, standing=False), candidate(20, contributors_for=contributors, **there)]
    assert summary(said(about, [], Pair(Kind.MOVED, 10, 20))) == [(None, kind, state)]


@pytest.mark.parametrize(("contributors", "kind"), [(1, "deleted"), (2, "moved")])
def test_what_became_of_a_sign_that_is_gone_is_for_a_quorum_to_say(contributors: int, kind: str) -> None:
    disputed = candidate(20, weight=1.0, standing=False, contributors_for=contributors, weight_against=0.9)
    assert summary(said([feature(10), disputed], [], Pair(Kind.MOVED, 10, 20))) == [(None, kind, State.CONFIRMED)]
    doubted = feature(10, weight=0.9, standing=False)  # nobody knows yet that it is gone
    [(_, _, state)] = summary(said([doubted, disputed], [], Pair(Kind.MOVED, 10, 20)))
    assert state is State.CANDIDATE


states = st.sampled_from(State)
rows = st.lists(
    st.tuples(
        st.sampled_from(Kind), states, st.sampled_from([None, 10, 11]), st.sampled_from([None, 20, 21]), st.booleans()
    ),
    max_size=6,
)
halves = st.lists(st.tuples(st.floats(0.0, 3.0), st.booleans(), st.integers(1, 9)), min_size=4, max_size=4)


@given(rows, halves, st.sampled_from([(), ((10, 20),), ((10, 21), (11, 20)), ((11, 21),)]))
def test_every_change_is_said_at_most_once(told: Any, now: Any, paired: Any) -> None:
    known = [
        row(key, kind, state, one, other, evidence_left=left)
        for key, (kind, state, one, other, left) in enumerate(told, 1)
        if (one, other) != (None, None)
    ]
    about = [
        (feature if number < 2 else candidate)(
            (10, 11, 20, 21)[number], weight=weight, standing=standing and weight > 1.0, contributors_for=count
        )
        for number, (weight, standing, count) in enumerate(now)
    ]
    entries = said(about, known, *(Pair(Kind.MOVED, one, other) for one, other in paired))
    revised = [one.published.id for one in entries if one.published is not None]
    assert len(revised) == len(set(revised))
    opened = [one.claim.ends for one in entries if one.published is None and one.claim is not None]
    assert len(opened) == len(set(opened))
    # Whatever is open afterwards about one thing is one change.
    left = {one.id: one.ends for one in known if one.state in OPEN and one.id not in revised}
    left |= {
        one.published.id: one.claim.ends if one.claim is not None else one.published.ends
        for one in entries
        if one.published is not None and one.state in OPEN
    }
    still = [*left.values(), *opened]
    for end in (0, 1):
        ids = [ends[end] for ends in still if ends[end] is not None]
        assert len(ids) == len(set(ids))
