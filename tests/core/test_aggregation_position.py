"""Fused positions: calibrated, order-free, and unmoved by one car that is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from slamcu_core.aggregation import ClassPolicy, fuse_positions, fuse_positions_each
from slamcu_core.errors import EvidenceError

POLICY = ClassPolicy()
FLOOR, COMMON = POLICY.position_floor_m, POLICY.position_common_m
CHI2_95 = 5.991
Array = NDArray[np.float64]


def _passes(rng: np.random.Generator, cars: int, each: int, wrong: int = 0) -> tuple[Array, Array, NDArray[np.intp]]:
    """Draw passes around the origin: a bias of all cars, one per car, and noise of known covariance per pass."""
    who = np.repeat(np.arange(cars), each)
    bias = rng.normal(0.0, COMMON, 2) + rng.normal(0.0, np.sqrt(FLOOR**2 - COMMON**2), (cars, 2))
    bias[:wrong] += 12.0
    angle, stds = rng.uniform(0.0, np.pi, who.size), np.array([0.9, 0.4]) * rng.uniform(0.5, 1.6, (who.size, 1))
    axes = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=-1).reshape(-1, 2, 2)
    noise = np.einsum("nij,nj->ni", axes, stds * rng.normal(size=(who.size, 2)))
    own = (axes * np.square(stds)[:, None, :]) @ axes.swapaxes(1, 2)
    return bias[who] + noise, own + FLOOR**2 * np.eye(2), who


@pytest.mark.parametrize(("cars", "each"), [(1, 1), (1, 12), (2, 2), (3, 1), (5, 3), (12, 1), (25, 1)])
def test_the_ellipse_covers_what_it_says(cars: int, each: int) -> None:
    rng = np.random.default_rng([cars, each])
    runs, covered, squared = 400, 0, 0.0
    for _ in range(runs):
        fused = fuse_positions(*_passes(rng, cars, each), POLICY)
        distance = float(fused.xy @ np.linalg.solve(fused.covariance, fused.xy))
        covered, squared = covered + (distance <= CHI2_95), squared + distance
    assert 0.915 <= covered / runs <= 0.98
    assert 1.7 <= squared / runs <= 2.5  # two degrees of freedom


@pytest.mark.parametrize(("cars", "each"), [(3, 1), (3, 6), (5, 2), (10, 1)])
def test_one_wrong_car_does_not_move_it(cars: int, each: int) -> None:
    rng = np.random.default_rng([7, cars, each])
    for _ in range(50):
        xy, covariance, who = _passes(rng, cars, each, wrong=1)
        fused = fuse_positions(xy, covariance, who, POLICY)
        assert not fused.inlier[who == 0].any()
        honest = fuse_positions(xy[who > 0], covariance[who > 0], who[who > 0], POLICY)
        # two cars alone are not gated, three are: one pass in a hundred may go
        same = bool((fused.inlier[who > 0] == honest.inlier).all())
        assert np.linalg.norm(fused.xy - honest.xy) <= (1e-9 if same else 0.5)


def test_who_was_near_only_with_the_help_of_one_who_is_not_goes_too() -> None:
    east = np.array([-0.3, 0.0, 0.3, 1.8, 2.6, 3.1])
    places, covariance = np.column_stack([east, np.zeros(6)]), np.tile(0.6**2 * np.eye(2), (6, 1, 1))
    fused = fuse_positions(places, covariance, np.arange(6), POLICY)
    assert fused.inlier.tolist() == [True, True, True, True, False, False]
    # each is judged by what the others say who are left
    for one in range(6):
        others = np.flatnonzero(fused.inlier & (np.arange(6) != one))
        distance = (east[one] - east[others].mean()) ** 2 / (0.6**2 * (1.0 + 1.0 / len(others)))
        assert (distance <= POLICY.gate) == fused.inlier[one]


def test_a_wrong_car_with_many_passes_has_one_voice() -> None:
    rng = np.random.default_rng(3)
    xy, covariance, who = _passes(rng, 4, 1)
    loud = np.vstack([xy, np.full((200, 2), 9.0)])
    fused = fuse_positions(
        loud, np.concatenate([covariance, np.tile(0.15 * np.eye(2), (200, 1, 1))]), [*who, *[9] * 200], POLICY
    )
    assert fused.contributors == 4
    assert np.linalg.norm(fused.xy) < 2.0


def test_one_wrong_pass_of_an_honest_car_is_left_out() -> None:
    xy, covariance, who = _passes(np.random.default_rng(5), 4, 3)
    xy[4] += 8.0
    fused = fuse_positions(xy, covariance, who, POLICY)
    assert not fused.inlier[4]
    assert fused.contributors == 4


@given(st.integers(1, 30), st.integers(0, 2**31), st.integers(1, 6))
def test_order_does_not_matter(passes: int, seed: int, cars: int) -> None:
    rng = np.random.default_rng(seed)
    who = rng.integers(0, cars, passes)
    shape = rng.normal(size=(passes, 2, 2))
    covariance = shape @ shape.swapaxes(1, 2) + 0.01 * np.eye(2)
    covariance = 0.5 * (covariance + covariance.swapaxes(1, 2))
    xy = rng.normal(0.0, 2.0, (passes, 2))
    order = rng.permutation(passes)
    one = fuse_positions(xy, covariance, who, POLICY)
    other = fuse_positions(xy[order], covariance[order], who[order], POLICY)
    np.testing.assert_array_equal(other.xy, one.xy)
    np.testing.assert_array_equal(other.covariance, one.covariance)
    np.testing.assert_array_equal(other.inlier, one.inlier[order])
    assert np.linalg.eigvalsh(one.covariance).min() > 0.0
    assert one.contributors == np.unique(who[one.inlier]).size >= 1


@pytest.mark.parametrize("wrong", [0, 1])
def test_where_the_frame_is_anchored_does_not_matter(wrong: int) -> None:
    for seed in range(40):
        xy, covariance, who = _passes(np.random.default_rng(seed), 6, 2, wrong=wrong)
        here, there = fuse_positions(xy, covariance, who, POLICY), fuse_positions(xy + 3_000.0, covariance, who, POLICY)
        np.testing.assert_allclose(there.xy - 3_000.0, here.xy, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(there.covariance, here.covariance, rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(there.inlier, here.inlier)


def test_a_single_pass_keeps_its_covariance() -> None:
    covariance = np.array([[2.0, 0.7], [0.7, 0.9]])
    fused = fuse_positions([[3.0, -4.0]], [covariance], [1], POLICY)
    np.testing.assert_allclose(fused.xy, [3.0, -4.0], atol=1e-12)
    np.testing.assert_allclose(fused.covariance, covariance, atol=1e-9)


def test_one_car_never_gets_below_its_floor_however_often_it_comes() -> None:
    xy, covariance, who = _passes(np.random.default_rng(8), 1, 500)
    alone = fuse_positions(xy, covariance, who, POLICY)
    assert np.linalg.eigvalsh(alone.covariance).min() >= FLOOR**2
    claimed = fuse_positions(xy, np.tile(1e-6 * np.eye(2), (500, 1, 1)), who, POLICY)
    assert np.linalg.eigvalsh(claimed.covariance).min() >= FLOOR**2


def test_different_cars_do_get_below_one_cars_floor() -> None:
    xy, covariance, who = _passes(np.random.default_rng(9), 40, 1)
    fused = fuse_positions(xy, covariance, who, POLICY)
    assert np.sqrt(np.linalg.eigvalsh(fused.covariance).max()) < FLOOR


def test_a_car_that_comes_often_does_not_outvote_the_others() -> None:
    # 100 passes of one car are worth one bias, not a hundredth of it
    xy = np.array([*[[1.0, 0.0]] * 100, [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    covariance = np.tile(0.25 * np.eye(2), (103, 1, 1))
    fused = fuse_positions(xy, covariance, [*[1] * 100, 2, 3, 4], POLICY)
    assert fused.xy[0] < 0.5


def test_two_cars_that_disagree_are_both_kept_and_the_ellipse_holds_both() -> None:
    fused = fuse_positions([[0.0, 0.0], [6.0, 0.0]], np.tile(0.25 * np.eye(2), (2, 1, 1)), [1, 2], POLICY)
    assert fused.inlier.all()
    assert fused.contributors == 2
    np.testing.assert_allclose(fused.xy, [3.0, 0.0], atol=1e-9)
    for place in ([0.0, 0.0], [6.0, 0.0]):
        difference = np.array(place) - fused.xy
        assert difference @ np.linalg.solve(fused.covariance, difference) <= CHI2_95


def test_where_no_two_agree_the_nearest_are_kept_and_nothing_is_certain() -> None:
    xy = np.array([[0.0, 0.0], [30.0, 0.0], [0.0, 20.0], [90.0, 90.0]])
    fused = fuse_positions(xy, np.tile(0.25 * np.eye(2), (4, 1, 1)), [1, 2, 3, 4], POLICY)
    assert fused.inlier.tolist() == [True, False, True, False]
    assert np.sqrt(np.linalg.eigvalsh(fused.covariance).min()) > 5.0


def test_needle_shaped_covariances_stay_well_conditioned() -> None:
    needles = np.array([np.diag([1e6, 1e-9]), np.diag([1e-9, 1e6]), np.diag([1e4, 1e4])])
    fused = fuse_positions([[500.0, 0.0], [0.0, 700.0], [3.0, 3.0]], needles, [1, 2, 3], POLICY)
    assert np.linalg.cond(fused.covariance) < 1e6
    np.testing.assert_allclose(fused.xy, [0.0, 0.0], atol=0.1)


@pytest.mark.parametrize(
    ("xy", "covariance", "contributor", "complaint"),
    [
        (np.zeros((0, 2)), np.zeros((0, 2, 2)), [], "N >= 1"),
        ([[0.0, 0.0, 0.0]], [np.eye(2)], [1], "shapes"),
        ([[0.0, 0.0]], [np.eye(2)], [1, 2], "shapes"),
        ([[np.nan, 0.0]], [np.eye(2)], [1], "finite"),
        ([[0.0, 0.0]], [[[np.inf, 0.0], [0.0, 1.0]]], [1], "finite"),
        ([[0.0, 0.0]], [[[1.0, 2.0], [2.0, 1.0]]], [1], "positive definite"),
        ([[0.0, 0.0]], [[[1.0, 0.5], [0.0, 1.0]]], [1], "symmetric"),
        ([[0.0, 0.0]], [np.zeros((2, 2))], [1], "positive definite"),
    ],
)
def test_positions_that_are_none_are_refused(
    xy: object, covariance: object, contributor: list[int], complaint: str
) -> None:
    with pytest.raises(EvidenceError, match=complaint):
        fuse_positions(xy, covariance, contributor, POLICY)  # type: ignore[arg-type]  # wrong on purpose


def test_many_things_are_fused_as_each_alone() -> None:
    rng = np.random.default_rng(8)
    drawn = []
    for cars in rng.integers(1, 9, 60).tolist():
        xy, covariance, who = _passes(rng, cars, 2, wrong=int(rng.integers(0, 2)))
        some = rng.permutation(who.size)[: int(rng.integers(1, who.size + 1))]
        drawn.append((xy[some] * rng.choice([1.0, 20.0]), covariance[some], who[some]))
    sizes = [len(who) for _, _, who in drawn]
    columns = [np.concatenate(parts) for parts in zip(*drawn, strict=True)]
    mixed = rng.permutation(sum(sizes))
    thing = np.repeat(np.arange(len(drawn)), sizes)[mixed]
    each = fuse_positions_each(*(column[mixed] for column in columns), thing, POLICY)
    for number, (xy, covariance, who) in enumerate(drawn):
        alone = fuse_positions(xy, covariance, who, POLICY)
        assert each.xy[number].tolist() == alone.xy.tolist()
        assert each.covariance[number].tolist() == alone.covariance.tolist()
        assert each.contributors[number] == alone.contributors
        assert np.count_nonzero(each.inlier[thing == number]) == np.count_nonzero(alone.inlier)


def test_of_two_pairs_of_strangers_the_first_is_kept_wherever_they_are() -> None:
    xy = np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 500.0], [9.0, 500.0]])
    for shift in (0.0, 1.0 / 3.0, 1234.5678):
        fused = fuse_positions(xy + shift, np.tile(0.25 * np.eye(2), (4, 1, 1)), [1, 2, 3, 4], POLICY)
        assert fused.inlier.tolist() == [True, True, False, False]
