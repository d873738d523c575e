"""A filter in doubt: detections that may be two things, odometry that fails, a poor sensor, poses far apart."""

from __future__ import annotations

import numpy as np
import pytest

from slamcu_core.filter.detectability import DetectionRate
from slamcu_core.filter.existence import bounded_by_view
from slamcu_core.filter.explanations import Explanations, exclusive, in_doubt, settle_on, shared_out, weigh
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.prediction import Travel, predict
from slamcu_core.filter.resampling import resample
from slamcu_core.filter.table import FeatureTable, Kind
from slamcu_core.models import MotionNoise


def cloud(count: int = 100, *, heading_std: float = 0.05, position_std: float = 0.1, seed: int = 0) -> Particles:
    return Particles.sample(
        count,
        2,
        position_std=position_std,
        heading=0.0,
        heading_std=heading_std,
        noise=MotionNoise.robot(),
        rng=np.random.default_rng(seed),
    )


def test_shares_are_the_posterior_of_equal_chances_and_the_unknown() -> None:
    shares = shared_out(np.log([[3.0, 1.0], [1e-9, 1e-9]]))
    assert shares[0] == pytest.approx([0.6, 0.2])
    assert shares[1].sum() == pytest.approx(0.0, abs=1e-8)
    assert in_doubt(np.log([[3.0, 1.0]]))
    assert not in_doubt(np.log([[1e4, 1e-9]]))
    assert not in_doubt(np.log([[1e-9, 1e-9]]))


def test_what_is_beyond_doubt_counts_in_full_and_what_is_shared_counts_by_its_share() -> None:
    columns, certain = settle_on(np.array([[0.995, 0.001], [0.1, 0.6], [0.05, 0.05]]))
    assert columns.tolist() == [0, 1, -1]
    assert certain == pytest.approx([1.0, 0.6, 0.9])


@pytest.mark.parametrize("seed", range(20))
def test_two_detections_of_a_frame_are_of_two_things(seed: int) -> None:
    odds = np.exp(np.random.default_rng(seed).normal(0.0, 2.0, (2, 3)))  # of features to something unknown
    joint = np.pad(odds, ((0, 0), (0, 1)), constant_values=1.0)
    joint = joint[0, :, None] * joint[1] * (1.0 - np.diag([1.0, 1.0, 1.0, 0.0]))
    exact = np.array([joint.sum(axis=1), joint.sum(axis=0)])[:, :3] / joint.sum()
    alone = odds / (1.0 + odds.sum(axis=1, keepdims=True))
    assert exclusive(alone) == pytest.approx(exact, abs=0.05)
    assert np.abs(exclusive(alone) - exact).max() <= np.abs(alone - exact).max()
    assert exclusive(alone[:1]) == pytest.approx(alone[:1])  # one detection has no rival


def test_detections_side_by_side_tell_together_which_is_which() -> None:
    # a new sign beside a mapped one: neither detection is beyond doubt by itself
    shares = np.array([[0.25, 0.74], [0.81, 0.18]])
    assert shares.max() < 0.82
    assert exclusive(shares) == pytest.approx(np.array([[0.0, 1.0], [1.0, 0.0]]), abs=0.03)


def test_each_particle_takes_a_detection_for_what_fits_it_and_both_kinds_live_on() -> None:
    # half of the particles see feature 0 where the detection is, the other half feature 1
    count = 100
    first = np.arange(count) < count // 2
    innovation = np.zeros((2, 2, count))
    innovation[1, 0, ~first] = innovation[1, 1, first] = 0.5  # rad: 20 standard deviations
    covariance = np.zeros((3, 2, count))
    covariance[0], covariance[2] = 0.01, 0.000625
    possible = np.ones((1, 2), dtype=bool)
    asked = Explanations(innovation, covariance, None, possible, np.array([-3.0]))
    weighed = weigh(asked, np.random.default_rng(0))
    assert weighed.shares[0, first].min() > 0.99
    assert weighed.shares[1, ~first].min() > 0.99
    assert np.ptp(weighed.log_likelihood) == pytest.approx(0.0, abs=1e-9)


def test_a_kernel_left_open_keeps_the_cloud_and_travels_with_it() -> None:
    particles = cloud(2000, heading_std=0.2, position_std=0.3)
    particles.log_weight = np.where(np.arange(2000) < 500, 0.0, -4.0)
    before = particles.mean_state()[1]
    assert resample(particles, 1.0, 0.2, np.random.default_rng(1), leave_open=True)
    assert particles.pending is not None
    assert particles.mean_state()[1][:3, :3] == pytest.approx(before[:3, :3], rel=0.15, abs=2e-3)
    predict(particles, Travel(1.0, 0.0, 1.0), MotionNoise.robot(), np.random.default_rng(2))
    waiting = particles.pending_covariance(particles.weights)
    # a heading that waits swings the place a metre ahead sideways
    assert waiting[1, 1] > waiting[2, 2] * 0.9


def test_particles_drawn_anew_keep_the_cloud_and_those_astray_reach_far_beyond_it() -> None:
    rng = np.random.default_rng(3)
    particles = cloud(100, heading_std=0.05)
    mean, covariance = particles.mean_state()
    many = particles.many(20, 0.5, rng)
    assert len(many) == 2000
    again = many.mean_state()
    assert again[0][:3] == pytest.approx(mean[:3], abs=0.03)
    assert np.diag(again[1])[:3] == pytest.approx(np.diag(covariance)[:3], rel=0.15)
    many.stray(particles, 0.02, 0.5, 5.0, rng)
    astray = np.exp(many.log_weight) < 1.0
    assert np.exp(many.log_weight)[astray].sum() / np.exp(many.log_weight).sum() == pytest.approx(0.02)
    assert many.state[2, astray].std() == pytest.approx(5.0 * np.sqrt(covariance[2, 2]), rel=0.1)


def test_a_sensor_s_poor_sight_far_away_is_learned_from_what_stands_there() -> None:
    rates, rng = DetectionRate(0.45, 8.0), np.random.default_rng(4)
    assert rates.within(np.array([1.0, 7.5])).now() == pytest.approx([0.45, 0.45])
    for _ in range(400):
        rates.within(np.array([1.5, 6.5])).learn(np.ones(2, bool), rng.random(2) < [0.8, 0.1], 1.0)
    near, far, beyond = rates.within(np.array([1.5, 6.5, 20.0])).now()
    assert near == pytest.approx(0.8, abs=0.06)
    assert far == pytest.approx(0.1, abs=0.06)
    assert beyond == pytest.approx(0.45)  # in the last bin, where nothing was learned


def test_misses_say_no_more_than_that_a_row_was_in_view() -> None:
    table = FeatureTable()
    row = np.array([table.add(Kind.MAP, feature_class=1, sign=0, value=0, prior=3.0)])
    total = 0.0
    for _ in range(200):  # of all particles a third have it in view, and always the same ones
        weight = bounded_by_view(table, row, table.evidence[row], np.array([0.3]), np.array([0.1]))
        table.pass_against[row] += weight
        total += float(weight[0])
    assert total == pytest.approx(-np.log(0.7))
    assert bounded_by_view(table, row, table.evidence[row], np.array([1.0]), np.array([0.1])) == pytest.approx([0.1])
