"""Trust only takes away, strangers need more company than those with a record, and lists and columns agree."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import (
    ClassPolicy,
    PassColumns,
    PassEvidence,
    Policy,
    Side,
    Trusts,
    contributions,
    fold,
    fold_columns,
)
from slamcu_core.errors import EvidenceError

FULL = 20.0
HOUR = 3600.0


def trusts(**known: Any) -> Trusts:
    """`trusts(c3=(0.5, True))`: contributor 3 has half the policy's trust, and a record (a number: since when, s)."""
    rows = sorted((int(name[1:]), *values) for name, values in known.items())
    return Trusts(
        1,
        np.array([row[0] for row in rows], np.int64),
        np.array([row[1] for row in rows], float),
        np.array([{True: -np.inf, False: np.inf}.get(row[2], row[2]) for row in rows], float),
    )


def standing(policy: ClassPolicy, side: Side, *says: tuple[int, float]) -> list[bool]:
    """Fold passes of an hour each, (contributor, +1 or -1), and return whether the change stands after each."""
    passes = [
        PassEvidence(who, number * HOUR, FULL * (sign > 0), FULL * (sign < 0))
        for number, (who, sign) in enumerate(says)
    ]
    prior = 3.0 if side is Side.DELETED else 0.0
    state = fold(contributions(passes, policy), prior_weight=prior, policy=policy, side=side)
    return [step.standing for step in state.steps]


def test_strangers_need_more_company_than_those_with_a_record() -> None:
    nobody, one = ClassPolicy(trusts=trusts()), ClassPolicy(trusts=trusts(c2=(1.0, True)))
    finds = [(number, 1.0) for number in range(1, 6)]
    assert standing(ClassPolicy(), Side.NEW, *finds) == [False, True, True, True, True]
    assert standing(nobody, Side.NEW, *finds) == [False, False, True, True, True]
    assert standing(one, Side.NEW, *finds) == [False, True, True, True, True]
    misses = [(number, -1.0) for number in range(1, 6)]
    everyone = standing(ClassPolicy(), Side.DELETED, *misses)
    assert standing(nobody, Side.DELETED, *misses) == everyone == [False, False, False, True, True]


def test_as_many_strangers_as_the_quorum_decide_nothing_however_often_they_come() -> None:
    nobody, alike = ClassPolicy(trusts=trusts()), ClassPolicy()
    for side, sign, quorum in ((Side.NEW, 1.0, 2), (Side.DELETED, -1.0, 3)):
        assert not any(standing(nobody, side, *[(number % quorum, sign) for number in range(40)]))
        assert any(standing(alike, side, *[(number % quorum, sign) for number in range(40)]))
    # nor do they take back what stands
    believed = [(number, 1.0) for number in range(10, 14)]
    assert standing(nobody, Side.NEW, *believed, *[(number % 2, -1.0) for number in range(40)])[-1]
    assert not standing(alike, Side.NEW, *believed, *[(number % 2, -1.0) for number in range(40)])[-1]


def test_a_record_counts_from_when_it_was_earned() -> None:
    """Who drives honestly by day must not confirm by that what he and another invented the night before."""
    finds = [(1, 1.0), (2, 1.0)]
    for since, stands in ((True, True), (HOUR / 2, True), (HOUR, False), (False, False)):
        policy = ClassPolicy(trusts=trusts(c2=(1.0, since)))
        assert standing(policy, Side.NEW, *finds) == [False, stands]
    late = ClassPolicy(trusts=trusts(c2=(1.0, 1.5 * HOUR)))
    assert standing(late, Side.NEW, *finds, (2, 1.0)) == [False, False, True]
    assert standing(late, Side.NEW, *finds, (1, 1.0)) == [False, False, False]
    # nor by what he says against it now
    assert standing(late, Side.NEW, *finds, (2, -1.0), (1, 1.0), (1, 1.0), (1, 1.0))[-1] is False


def test_the_first_version_takes_nothing_back() -> None:
    """Before it nobody has a record; whoever gets one by it only makes decisions easier."""
    before, after = ClassPolicy(trusts=Trusts()), ClassPolicy(trusts=trusts(c2=(1.0, True), c9=(1.0, True)))
    for side, sign in ((Side.NEW, 1.0), (Side.DELETED, -1.0)):
        said = [(number, sign) for number in range(1, 6)]
        stood = standing(before, side, *said)
        assert stood[-1]
        assert all(now or not then for then, now in zip(stood, standing(after, side, *said), strict=True))


def test_what_two_others_have_refuted_since_is_no_voice() -> None:
    """It takes new voices then, however much the others say."""
    refuted = [(1, -1.0), (2, -1.0), (3, -1.0), (8, 1.0), (9, 1.0)]
    for known in (None, trusts(), trusts(c1=(1.0, True))):
        policy = ClassPolicy(trusts=known)
        assert not any(standing(policy, Side.DELETED, *refuted, *[(1, -1.0), (2, -1.0)] * 4))
        assert standing(policy, Side.DELETED, *refuted, *[(1, -1.0), (2, -1.0), (4, -1.0), (5, -1.0)] * 2)[-1]


def test_strangers_who_find_a_sign_outvote_one_who_misses_it_by_one_more() -> None:
    nobody, one = ClassPolicy(trusts=trusts()), ClassPolicy(trusts=trusts(c3=(1.0, True)))
    finds = [(1, 1.0), (2, 1.0), (9, -1.0), (3, 1.0), (4, 1.0)]
    assert standing(nobody, Side.NEW, *finds) == [False, False, False, False, True]
    assert standing(one, Side.NEW, *finds) == [False, False, False, True, True]
    assert not any(standing(nobody, Side.NEW, *finds[:4], (8, -1.0), *finds[4:], (5, 1.0)))  # two have refuted it


@pytest.mark.parametrize(("weight", "refutes"), [(0.6, False), (0.8, True)])
def test_who_could_hardly_look_refutes_nobody(weight: float, refutes: bool) -> None:
    """A truck hid all but a frame: then neither mass of the pass is more than what it does not know."""
    policy = ClassPolicy(trusts=trusts())
    found = [PassEvidence(number, 2.0 * number * HOUR, FULL, 0.0) for number in range(3)]
    glimpse = PassEvidence(9, 3.0 * HOUR, 0.0, weight)
    told = contributions([*found, glimpse], policy)
    assert fold(told, prior_weight=0.0, policy=policy, side=Side.NEW).standing is not refutes


def test_where_nobody_is_a_stranger_the_quorum_is_all_it_takes() -> None:
    """A provider that knows its cars says so: then it needs no record of them either."""
    known, alike = ClassPolicy(strangers_more=0, trusts=trusts()), ClassPolicy()
    for side, sign in ((Side.NEW, 1.0), (Side.DELETED, -1.0)):
        for said in ([1, 2, 3, 4], [1, -9, 2, 3, 4, 5], [1, 2, -9, 3, 4], [1, -8, 2, -9, 3, 4, 5, 6]):
            passes = [(abs(who), sign if who > 0 else -sign) for who in said]
            assert standing(known, side, *passes) == standing(alike, side, *passes)


def test_strangers_must_be_of_one_mind_about_a_deletion_and_those_with_a_record_may_lack_one() -> None:
    nobody, one = ClassPolicy(trusts=trusts()), ClassPolicy(trusts=trusts(c5=(1.0, True)))
    refuted = [(1, -1.0), (2, -1.0), (3, -1.0), (9, 1.0), (4, -1.0), (5, -1.0)]
    assert not any(standing(nobody, Side.DELETED, *refuted, (6, -1.0)))
    assert standing(one, Side.DELETED, *refuted)[-1]
    assert standing(nobody, Side.DELETED, *refuted, (6, -1.0), (7, -1.0))[-1]


def test_one_who_always_says_the_opposite_keeps_nothing_from_standing_or_falling() -> None:
    policy = ClassPolicy(trusts=trusts(c1=(1.0, True)))
    crowd = [(number % 9, -1.0) if number % 4 else (99, 1.0) for number in range(1, 40)]
    assert standing(policy, Side.DELETED, *crowd)[-1]
    fallen = standing(ClassPolicy(trusts=trusts()), Side.DELETED, *crowd, *[(who, -sign) for who, sign in crowd])
    assert not fallen[-1]


def test_cars_that_miss_it_now_and_then_do_not_take_back_what_others_see_in_between() -> None:
    policy = ClassPolicy(trusts=trusts())
    found = [PassEvidence(number, number * HOUR, FULL, 0.0) for number in range(5)]
    missed = [PassEvidence(number, number * HOUR, 0.0, FULL) for number in range(5, 25)]
    glimpsed = [PassEvidence(100 + item.contributor, item.ended_at + HOUR / 2, 0.6, 0.0) for item in missed]
    stands = [
        fold(contributions([*found, *said], policy), prior_weight=0.0, policy=policy, side=Side.NEW).standing
        for said in (missed, missed + glimpsed)
    ]
    assert stands == [False, True]


def test_where_one_car_decides_anyway_it_needs_no_record() -> None:
    single = ClassPolicy(contributors_new=1, enter=0.6, trusts=trusts())
    assert standing(single, Side.NEW, (1, 1.0)) == [True]


def test_a_contributor_without_trust_neither_says_nor_erases() -> None:
    honest = [PassEvidence(number, number * HOUR, FULL, 0.0) for number in range(1, 4)]
    liar = PassEvidence(9, 9 * HOUR, 0.0, FULL)
    policy = ClassPolicy(trusts=trusts(c9=(0.05, False)))
    with_liar, without = (
        fold(contributions(passes, policy), prior_weight=0.0, policy=policy, side=Side.NEW)
        for passes in ([*honest, liar], honest)
    )
    assert with_liar.weight_for == without.weight_for
    assert with_liar.weight_against == 0.0


def test_trust_is_no_parameter_of_the_policy() -> None:
    policy = Policy(classes={"pole": ClassPolicy(contributors_new=3)})
    table = trusts(c1=(0.5, False))
    known = policy.trusting(table)
    assert known.version == policy.version
    assert known.to_document() == policy.to_document()
    assert known == policy
    assert known.for_class("traffic_sign").trusts is known.for_class("pole").trusts is table
    assert known.for_class("pole").contributors_new == 3
    with pytest.raises(EvidenceError, match=r"default\.trusts is unknown"):
        Policy.from_document({"default": {"trusts": None}})


@pytest.mark.parametrize(
    ("contributor", "share", "message"),
    [([2, 1], [1.0, 1.0], "ascend"), ([1], [1.5], "share"), ([1, 2], [1.0], "one share")],
)
def test_a_table_that_cannot_be_is_refused(contributor: list[int], share: list[float], message: str) -> None:
    with pytest.raises(EvidenceError, match=message):
        Trusts(1, np.array(contributor, np.int64), np.array(share), np.zeros(len(share)))


@given(
    says=st.lists(
        st.tuples(st.integers(0, 2), st.integers(1, 6), st.integers(0, 30), st.floats(0, 5), st.floats(0, 5)),
        min_size=1,
        max_size=40,
    ),
    known=st.dictionaries(st.integers(1, 6), st.tuples(st.floats(0, 1), st.booleans() | st.floats(0, 30 * HOUR))),
    deleted=st.booleans(),
)
def test_columns_and_lists_agree_under_any_table(says: Any, known: Any, deleted: bool) -> None:
    policy = replace(ClassPolicy(), trusts=trusts(**{f"c{who}": values for who, values in known.items()}))
    feature, contributor, hour, weight_for, weight_against = (np.array(column) for column in zip(*says, strict=True))
    columns = fold_columns(
        PassColumns(
            feature.astype(np.intp), contributor, hour * HOUR, weight_for.astype(float), weight_against.astype(float)
        ),
        [1.0, 1.0, 1.0],
        policy,
        deleted=deleted,
    )
    for number in range(3):
        passes = [PassEvidence(who, at * HOUR, f, a) for which, who, at, f, a in says if which == number]
        state = fold(
            contributions(passes, policy),
            prior_weight=1.0,
            policy=policy,
            side=Side.DELETED if deleted else Side.NEW,
        )
        assert columns.weight_for[number] == pytest.approx(state.weight_for, abs=1e-12)
        assert columns.weight_against[number] == pytest.approx(state.weight_against, abs=1e-12)
        assert columns.standing[number] == state.standing
