"""Who is right is told by others, never by few; honest cars keep all their trust, liars and lost cars lose it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from slamcu_core.aggregation import About, has_record, is_gated, judge, tally, trust_share
from slamcu_core.aggregation import Testimony as Word
from slamcu_core.aggregation.record import FLOOR, Tally

HOUR = 3600.0


def said(*says: tuple[int, bool], find: bool = False) -> list[Word]:
    """What contributors said, one an hour, of what nobody (`find`: the first) had told them to look at."""
    return [
        Word(who, f"s{who}", number * HOUR, exists, find=find and number == 0)
        for number, (who, exists) in enumerate(says)
    ]


def rights(testimonies: list[Word], about: About = About.MAPPED) -> dict[int, bool]:
    return {one.testimony.contributor: one.right for one in judge(testimonies, about)}


def test_nobody_is_judged_by_himself_or_by_few() -> None:
    assert rights(said((1, True), (1, True), (1, True), (1, True))) == {}
    assert rights(said((1, False), (2, True), (3, True))) == {}
    assert rights(said((1, False), (2, True), (3, True), (4, True))) == {1: False}


def test_three_who_collude_make_neither_themselves_right_nor_others_wrong() -> None:
    liars_first = said(*[(who, False) for who in (1, 2, 3)], *[(who, True) for who in range(10, 18)])
    assert {who: right for who, right in rights(liars_first).items() if who <= 3} == {1: False, 2: False, 3: False}
    surrounded = said((10, True), *[(who, False) for who in (1, 2, 3)], *[(who, True) for who in range(11, 16)])
    assert 10 not in rights(surrounded)
    assert not any(rights(said(*[(1 + number % 3, False) for number in range(30)])).values())


def test_what_was_true_when_it_was_said_is_not_wrong_when_it_has_changed() -> None:
    removed = said(*[(who, True) for who in range(1, 7)], *[(who, False) for who in range(7, 13)])
    assert rights(removed) == {7: True, 8: True, 9: True}
    fresh = said((1, True), *[(who, False) for who in range(2, 8)])  # of whom the map alone says that he was right
    assert 1 not in rights(fresh)
    assert rights(fresh, About.CANDIDATE)[1] is False


def test_saying_it_again_within_the_hour_counts_once() -> None:
    flood = [Word(1, f"s{number}", number, exists=False) for number in range(100)]
    honest = [Word(who, "s", HOUR * who, exists=True) for who in range(2, 8)]
    assert tally(one for one in judge(flood + honest, About.MAPPED) if one.testimony.contributor == 1).wrong == 1


def test_gated_sessions_are_judged_and_judge_nobody() -> None:
    deaf = [Word(who, "s", HOUR * who, exists=False, heard=False) for who in range(2, 8)]
    assert rights([Word(1, "s", 0.0, exists=True), *deaf]) == {}
    honest = [Word(who, "s", HOUR * who, exists=True) for who in range(10, 14)]
    assert not any(one.right for one in judge(deaf + honest, About.MAPPED) if not one.testimony.heard)


def test_a_find_that_others_claim_too_is_told_from_clutter() -> None:
    refuted = [Word(who, "s", HOUR * who, exists=False) for who in range(10, 14)]
    lone = [Word(1, "s", 0.0, exists=True, find=True)]
    two = [*lone, Word(2, "s", HOUR, exists=True, find=True)]
    alone = [one for one in judge(lone + refuted, About.CANDIDATE) if one.testimony.find]
    assert tally(alone) == Tally(0, 1, 0, 1, false_finds=1)
    shared = [one for one in judge(two + refuted, About.CANDIDATE) if one.testimony.find]
    assert tally(shared) == Tally(0, 2, 0, 2, conspired=2)


def test_an_honest_car_keeps_all_trust_and_liars_lose_it() -> None:
    rng = np.random.default_rng(1)
    for miss in (0.02, 0.05, 0.10):
        wrong = rng.binomial(60, miss, 2000)
        shares = [trust_share(Tally(60 - int(count), int(count))) for count in wrong]
        assert np.mean(np.array(shares) < 1.0) < 0.001
    assert trust_share(Tally(55, 50, 0, 50, false_finds=50)) == 1.0
    assert trust_share(Tally(55, 20, 0, 20, conspired=20)) < 0.3
    assert trust_share(Tally(0, 60)) == FLOOR
    assert trust_share(Tally(10_000, 0)) == 1.0


@pytest.mark.parametrize(
    ("counted", "share"),
    [
        (Tally(62, 18), 1.0),  # with what everybody starts with, right 80 times in 100
        (Tally(61, 19), 0.95),
        (Tally(47, 33), 0.5),  # 65 in 100: half way to the toss of a coin
        (Tally(32, 48), FLOOR),  # the toss of a coin
        (Tally(47, 33, 0, 9, false_finds=9), 0.7),  # 65 in 91: clutter is not counted
        (Tally(47, 33, 0, 1, conspired=1), 0.4),  # 65 in 104: what others claim too counts five times
    ],
)
def test_trust_goes_from_all_of_it_to_the_floor_as_a_record_nears_the_toss_of_a_coin(
    counted: Tally, share: float
) -> None:
    assert trust_share(counted) == pytest.approx(share)


def test_trust_falls_with_every_wrong_word_and_never_below_the_floor() -> None:
    for one, other in pairwise(trust_share(Tally(40, wrong)) for wrong in range(200)):
        assert FLOOR <= other <= one


@pytest.mark.parametrize(
    ("counted", "expected"),
    [
        (Tally(500, 0), False),  # mapped features can be had by reading the map
        (Tally(3, 0, 3, 0), True),
        (Tally(2, 0, 2, 0), False),
        (Tally(9, 4, 9, 4), False),
        (Tally(9, 20, 9, 20, false_finds=20), True),  # a camera with clutter
        (Tally(9, 3, 9, 3, conspired=3), False),
    ],
)
def test_a_record_takes_claims_that_only_who_was_there_can_get_right(counted: Tally, expected: bool) -> None:
    assert has_record(counted) is expected


def test_a_session_is_gated_when_most_of_it_is_wrong() -> None:
    assert is_gated(Tally(10, 10))
    assert not is_gated(Tally(11, 9))
    assert not is_gated(Tally(0, 7))
