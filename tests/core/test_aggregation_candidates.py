"""Candidates: the partition is a pure function of the set of passes, and respects what a camera knows."""

from __future__ import annotations

import dataclasses
from collections import Counter
from dataclasses import dataclass
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slamcu_core.aggregation import ClassPolicy, Clusters, Passes, Policy, cluster, connected_groups
from slamcu_core.errors import EvidenceError

POLICY = Policy()


@dataclass(frozen=True)
class Pass:
    x: float
    y: float = 0.0
    std: float = 0.5
    seen: bool = True
    feature_class: str = "traffic_sign"
    sign: str | None = None
    value: str | None = None
    contributor: int = 1
    session: str = "a"
    start: float = 0.0
    index: int = 0
    doubtful: bool = False

    @property
    def identity(self) -> tuple[float, int, str, int, int]:
        return (self.start + 4.0, self.contributor, self.session, 1, self.index)


def _cluster(passes: list[Pass], policy: Policy = POLICY) -> Clusters:
    [clusters] = cluster([_passes(passes)], policy)
    return clusters


def _passes(passes: list[Pass]) -> Passes:
    return Passes(
        xy=[(p.x, p.y) for p in passes],
        covariance=[p.std**2 * np.eye(2) for p in passes],
        evidence_sign=[1 if p.seen else -1 for p in passes],
        group_key=[p.feature_class for p in passes],
        sign=[p.sign for p in passes],
        value=[p.value for p in passes],
        observer=[(p.contributor, p.session) for p in passes],
        interval=[(p.start, p.start + 4.0) for p in passes],
        order_key=[p.identity for p in passes],
        doubtful=[p.doubtful for p in passes],
    )


def _partition(passes: list[Pass], clusters: Clusters) -> dict[Pass, frozenset[Pass] | None]:
    """Return the cluster of each pass as the set of its members."""
    members: dict[int, set[Pass]] = {}
    for item, label in zip(passes, clusters.labels.tolist(), strict=True):
        members.setdefault(label, set()).add(item)
    return {
        item: frozenset(members[label]) if label >= 0 else None
        for item, label in zip(passes, clusters.labels.tolist(), strict=True)
    }


def _drives(rng: np.random.Generator, places: list[tuple[float, float]], cars: int, std: float = 0.5) -> list[Pass]:
    """Return finds of objects that each car has in view together, in one session each."""
    return [
        Pass(
            x=place[0] + rng.normal(0.0, std),
            y=place[1] + rng.normal(0.0, std),
            std=std,
            contributor=car,
            session=f"s{car}",
            start=100.0 * car,
            index=index,
        )
        for car in range(cars)
        for index, place in enumerate(places)
    ]


def _mostly(labels: list[int]) -> tuple[int, int]:
    return Counter(labels).most_common(1)[0]


some_passes = st.lists(
    st.builds(
        Pass,
        x=st.floats(-6.0, 6.0),
        y=st.floats(-3.0, 3.0),
        std=st.sampled_from([0.1, 0.5, 2.0]),
        seen=st.booleans(),
        feature_class=st.sampled_from(["traffic_sign", "pole"]),
        sign=st.sampled_from([None, "STOP", "YIELD"]),
        value=st.sampled_from([None, None, "80", "50"]),
        contributor=st.integers(1, 4),
        session=st.sampled_from(["a", "b"]),
        start=st.sampled_from([0.0, 3.0, 100.0, 200.0]),
        index=st.integers(0, 10**6),
    ),
    max_size=18,
    unique_by=lambda item: item.identity,
)


@given(some_passes, st.randoms(use_true_random=False))
def test_the_order_of_arrival_does_not_matter(passes: list[Pass], random: Random) -> None:
    shuffled = list(passes)
    random.shuffle(shuffled)
    one, other = _cluster(passes), _cluster(shuffled)
    assert _partition(shuffled, other) == _partition(passes, one)
    # the numbers too: clusters are numbered by their founders, who have an order of their own
    assert [shuffled[i] for i in other.founders] == [passes[i] for i in one.founders]


@given(some_passes)
def test_a_partition_keeps_the_rules(passes: list[Pass]) -> None:
    clusters = _cluster(passes)
    identities = [passes[i].identity for i in clusters.founders]
    assert identities == sorted(identities)
    for number, founder in enumerate(clusters.founders.tolist()):
        mine = [item for item, label in zip(passes, clusters.labels.tolist(), strict=True) if label == number]
        finds = [item for item in mine if item.seen]
        assert passes[founder] == min(finds, key=lambda item: item.identity)
        assert len({item.feature_class for item in mine}) == 1
        assert len({item.sign for item in finds} - {None}) <= 1
        assert len({item.value for item in finds} - {None}) <= 1
        for one in finds:
            for other in finds:
                if one is not other and (one.contributor, one.session) == (other.contributor, other.session):
                    told_twice = (one.start, one.x, one.y) == (other.start, other.x, other.y)
                    assert told_twice or abs(one.start - other.start) > 4.0
    for item, label in zip(passes, clusters.labels.tolist(), strict=True):
        assert label >= (0 if item.seen else -1)


@given(some_passes, some_passes)
def test_a_connected_group_does_not_depend_on_the_others(near: list[Pass], far: list[Pass]) -> None:
    far = [dataclasses.replace(item, x=item.x + 100.0, session=f"far-{item.session}") for item in far]
    together = _partition([*near, *far], _cluster([*near, *far]))
    apart = _partition(near, _cluster(near)) | _partition(far, _cluster(far))
    assert together == apart


@given(some_passes)
def test_no_cluster_reaches_beyond_its_connected_group(passes: list[Pass]) -> None:
    groups = connected_groups(np.array([(p.x, p.y) for p in passes]).reshape(-1, 2), POLICY.reach_m)
    labels = _cluster(passes).labels
    for number in set(labels.tolist()) - {-1}:
        assert len(set(groups[labels == number].tolist())) == 1


@pytest.mark.parametrize("cars", [1, 3, 8, 25])
def test_two_signs_two_metres_apart_stay_apart(cars: int) -> None:
    rng = np.random.default_rng([cars, 1])
    wrong = runs = 0
    for _ in range(20):
        passes = _drives(rng, [(0.0, 0.0), (2.0, 0.0)], cars)
        labels = _cluster(passes).labels.tolist()
        (left, agree_left), (right, agree_right) = _mostly(labels[::2]), _mostly(labels[1::2])
        assert left != right
        wrong, runs = wrong + 2 * cars - agree_left - agree_right, runs + 2 * cars
    assert wrong / runs < 0.06


@pytest.mark.parametrize("cars", [10, 30])
def test_two_signs_stay_apart_though_no_car_sees_both(cars: int) -> None:
    rng = np.random.default_rng([cars, 2])
    for _ in range(10):
        passes = [
            dataclasses.replace(item, session=f"{item.session}-{item.index}")
            for item in _drives(rng, [(0.0, 0.0), (2.5, 0.0)], cars)
        ]
        labels = _cluster(passes).labels.tolist()
        assert _mostly(labels[::2])[0] != _mostly(labels[1::2])[0]


@pytest.mark.parametrize("cars", [2, 5, 20, 60])
def test_one_sign_is_one_candidate_but_for_a_stray_find(cars: int) -> None:
    rng = np.random.default_rng([cars, 3])
    stray = total = 0
    for _ in range(20):
        labels = _cluster(_drives(rng, [(0.0, 0.0)], cars)).labels.tolist()
        _, agree = _mostly(labels)
        stray, total = stray + cars - agree, total + cars
        # what strays strays alone: it never makes a second candidate with a quorum of its own
        assert all(count == 1 for _, count in Counter(labels).most_common()[1:])
    assert stray / total < 0.03


def test_two_signs_on_one_pole_are_two_objects() -> None:
    rng = np.random.default_rng(4)
    passes = _drives(rng, [(0.0, 0.0), (0.0, 0.0)], 6)
    labels = _cluster(passes).labels
    assert all(labels[i] != labels[i + 1] for i in range(0, 12, 2))


def test_signs_on_one_pole_are_told_apart_by_what_they_say() -> None:
    rng = np.random.default_rng(5)
    names = [("STOP", None), ("SPEED_LIMIT", "80")]
    passes = [
        dataclasses.replace(item, sign=names[item.index][0], value=names[item.index][1])
        for item in _drives(rng, [(0.0, 0.0), (0.0, 0.0)], 6)
    ]
    labels = _cluster(passes).labels.tolist()
    assert set(labels[::2]) == {labels[0]}
    assert set(labels[1::2]) == {labels[1]}
    assert labels[0] != labels[1]


def test_one_session_may_find_one_sign_twice_if_it_left_the_view_between() -> None:
    again = [Pass(0.0), Pass(0.1, start=60.0, index=1)]
    at_once = [Pass(0.0), Pass(0.1, start=3.0, index=1)]
    assert _cluster(again).labels.tolist() == [0, 0]
    assert _cluster(at_once).labels.tolist() == [0, 1]


def test_an_unreadable_sign_goes_with_any_but_does_not_join_two() -> None:
    passes = [
        Pass(0.0, sign="STOP"),
        Pass(0.2, contributor=2, session="b", start=100.0),
        Pass(0.4, sign="YIELD", contributor=3, session="c", start=200.0),
    ]
    stop, unread, give_way = _cluster(passes).labels.tolist()
    assert stop != give_way
    assert unread in (stop, give_way)


def test_two_signs_do_not_meet_in_a_cluster_that_could_read_neither() -> None:
    # each named find sits nearer its namesake, but the unread cluster between them is larger and draws both
    passes = [
        Pass(0.0, contributor=1, session="a"),
        Pass(0.0, contributor=2, session="b", index=1),
        Pass(0.7, sign="STOP", contributor=3, session="c", index=2),
        Pass(1.0, sign="STOP", contributor=1, session="a", index=3),
        Pass(-0.7, sign="YIELD", contributor=4, session="d", index=4),
        Pass(-1.0, sign="YIELD", contributor=2, session="b", index=5),
    ]
    labels = _cluster(passes).labels
    assert labels[0] == labels[1]
    assert not {*labels[2:4]} & {*labels[4:]}
    assert labels[0] != labels[3]
    assert labels[1] != labels[5]


def test_where_the_frame_is_anchored_does_not_matter() -> None:
    passes = _drives(np.random.default_rng(7), [(0.0, 0.0), (2.0, 0.0), (9.0, 4.0)], 8)
    moved = [dataclasses.replace(item, x=item.x + 2_000.0, y=item.y - 3_000.0) for item in passes]
    assert _cluster(moved).labels.tolist() == _cluster(passes).labels.tolist()


def test_a_miss_goes_to_the_nearest_candidate_and_founds_none() -> None:
    passes = [
        Pass(0.0, start=100.0),
        Pass(3.0, start=200.0, session="b"),
        Pass(0.9, seen=False, start=0.0, session="c"),  # the earliest of all
        Pass(2.2, seen=False, start=300.0, session="d"),
        Pass(40.0, seen=False, start=400.0, session="e"),
        Pass(0.1, seen=False, start=500.0, session="f", feature_class="pole"),
        Pass(0.1, seen=False, start=600.0, session="g", sign="STOP"),
    ]
    clusters = _cluster(passes)
    assert clusters.labels.tolist() == [0, 1, 0, 1, -1, -1, 0]
    assert clusters.founders.tolist() == [0, 1]
    assert _cluster([dataclasses.replace(item, seen=False) for item in passes]).founders.size == 0


def test_what_is_far_never_joins_however_vague_it_is() -> None:
    vague = [Pass(0.0, std=30.0), Pass(6.0, std=30.0, session="b", start=100.0)]
    assert _cluster(vague).labels.tolist() == [0, 1]
    wider = Policy(classes={"traffic_sign": ClassPolicy(match_radius_m=10.0)})
    assert _cluster(vague, wider).labels.tolist() == [0, 0]


def test_a_late_report_changes_the_founder_and_not_the_members() -> None:
    rng = np.random.default_rng(6)
    passes = _drives(rng, [(0.0, 0.0)], 5, std=0.3)
    late = Pass(0.0, std=0.3, contributor=9, session="late", start=-500.0)
    before, after = _cluster(passes), _cluster([*passes, late])
    assert before.labels.tolist() == [0] * 5
    assert after.labels.tolist() == [0] * 6
    assert after.founders.tolist() == [5]


def test_nothing_makes_no_cluster() -> None:
    clusters = _cluster([])
    assert clusters.labels.shape == clusters.founders.shape == (0,)


def test_repeated_identities_and_useless_places_are_refused() -> None:
    with pytest.raises(EvidenceError, match="identity"):
        _cluster([Pass(0.0), Pass(1.0)])
    with pytest.raises(EvidenceError, match="finite"):
        _cluster([Pass(float("nan"))])
    with pytest.raises(EvidenceError, match="positive definite"):
        _cluster([Pass(0.0, std=0.0)])
    with pytest.raises(EvidenceError, match="one entry for each pass"):
        cluster([dataclasses.replace(_passes([Pass(0.0), Pass(1.0, index=1)]), sign=[None])], POLICY)


def test_a_find_that_one_session_tells_again_and_again_is_one_object() -> None:
    """A message sent again under new ids must not found a candidate for each copy."""

    def clusters(places: list[tuple[float, float]]) -> int:
        passes = [Pass(x, y, sign="STOP_SIGN", index=number) for number, (x, y) in enumerate(places)]
        return len(_cluster(passes).founders)

    assert clusters([(0.0, 0.0)] * 9) == 1
    assert clusters([(0.5 * number, 0.0) for number in range(3)]) == 3


_TOLD = st.builds(
    Pass,
    x=st.integers(0, 60).map(lambda n: 0.25 * n),
    std=st.sampled_from([0.3, 1.0]),
    seen=st.sampled_from([True, True, False]),
    sign=st.sampled_from([None, "STOP_SIGN", "YIELD"]),
    contributor=st.integers(1, 4),
    doubtful=st.booleans(),
)


@given(told=st.lists(_TOLD, max_size=14))
def test_what_was_said_in_doubt_does_not_change_what_the_others_are(told: list[Pass]) -> None:
    passes = [dataclasses.replace(item, index=number) for number, item in enumerate(told)]
    sure = [item for item in passes if not item.doubtful]
    alone, together = _partition(sure, _cluster(sure)), _partition(passes, _cluster(passes))
    for item in sure:
        mine, before = together[item], alone[item]
        if before is not None:
            assert mine is not None
            assert {other for other in mine if not other.doubtful} == before
        elif mine is not None:  # a miss that was near nothing may be near what was found in doubt
            assert not item.seen
            assert all(other.doubtful for other in mine if other.seen)


def test_finds_in_doubt_that_nobody_else_has_made_are_a_candidate_of_their_own() -> None:
    there = [Pass(10.0 + 0.1 * car, contributor=car, index=car, doubtful=True) for car in range(3)]
    lost = [Pass(60.0, contributor=8, index=8, doubtful=True)]
    sure = [Pass(10.5, contributor=9, index=9)]
    assert len(_cluster(there + lost).founders) == 2
    joined = _cluster(there + lost + sure)
    assert joined.labels[:3].tolist() == [joined.labels[4]] * 3
    assert joined.founders[joined.labels[4]] == 4, "who was sure has founded it"


@given(told=st.lists(st.lists(_TOLD, max_size=9), max_size=6))
def test_groups_are_partitioned_side_by_side_as_each_would_be_alone(told: list[list[Pass]]) -> None:
    groups = [[dataclasses.replace(item, index=number) for number, item in enumerate(each)] for each in told]
    together = cluster([_passes(group) for group in groups], POLICY)
    assert [_partition(group, one) for group, one in zip(groups, together, strict=True)] == [
        _partition(group, _cluster(group)) for group in groups
    ]
