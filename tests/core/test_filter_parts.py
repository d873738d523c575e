"""The operations of section 5: EKF (16), weights (17-19), resampling (20), and the one-to-one assignment (4.3.1)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment
from scipy.stats import multivariate_normal

from slamcu_core.drive import Sensor
from slamcu_core.filter import FilterParameters, ekf
from slamcu_core.filter.assignment import assign
from slamcu_core.filter.calibration import Calibrations, GnssBias, SensorCalibration
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.resampling import resample, systematic
from slamcu_core.filter.weighting import combine, gaussian_log_likelihood, robust_log_likelihood
from slamcu_core.geometry import inverse, mahalanobis_square, wrap_angle
from slamcu_core.models import Jacobian, MotionNoise, SensorModel

SEEDS = st.integers(0, 2**32 - 1)


def _covariance(rng: np.random.Generator) -> np.ndarray:
    root = rng.normal(size=(2, 2))
    return root @ root.T + 0.05 * np.eye(2)


def _components(matrix: np.ndarray) -> np.ndarray:
    return np.array([matrix[0, 0], matrix[0, 1], matrix[1, 1]])


def _jacobian(rng: np.random.Generator) -> Jacobian:
    angle = rng.uniform(-np.pi, np.pi)
    return Jacobian(np.cos(angle), np.sin(angle), 1.0 / rng.uniform(0.5, 5.0))


@given(SEEDS)
def test_the_update_of_eq_16_is_bayes_rule_for_gaussians(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covariance, jacobian, noise = _covariance(rng), _jacobian(rng), rng.uniform(0.1, 2.0, 2)
    mean, innovation = rng.normal(size=2), rng.normal(size=2)
    moved, spread = ekf.update(mean, ekf.projected(jacobian, _components(covariance)), jacobian, innovation, noise)
    h = jacobian.matrix
    information = np.linalg.inv(covariance) + h.T @ np.diag(1 / noise) @ h
    np.testing.assert_allclose(spread, _components(np.linalg.inv(information)), rtol=1e-6, atol=1e-9)
    expected = mean + np.linalg.solve(information, h.T @ (innovation / noise))
    np.testing.assert_allclose(moved, expected, rtol=1e-6, atol=1e-9)


def test_covariances_stay_positive_definite_over_ten_thousand_updates() -> None:
    model, pose = SensorModel(Sensor("camera", bearing_std_rad=1e-4)), np.array([0.0, 0.0, 0.1])
    mean, covariance = np.array([40.0, 3.0]), np.array([100.0, 0.0, 100.0])
    for _ in range(10_000):
        h = model.feature_jacobian(pose, mean)
        noise = model.noise(model.predict(pose, mean))
        mean, covariance = ekf.update(mean, ekf.projected(h, covariance), h, np.zeros(2), noise)
    assert np.all(np.linalg.eigvalsh(covariance[[0, 1, 1, 2]].reshape(2, 2)) > 0.0)


@given(SEEDS)
def test_closed_forms_are_the_products_of_matrices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covariance, jacobian, noise = _covariance(rng), _jacobian(rng), rng.uniform(0.1, 2.0, 2)
    h, small = jacobian.matrix, _components(covariance)
    along = _components(h @ covariance @ h.T)
    np.testing.assert_allclose(ekf.projected(jacobian, small), along, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(inverse(small), _components(np.linalg.inv(covariance)), rtol=1e-9, atol=1e-12)
    born = np.linalg.inv(h) @ np.diag(noise) @ np.linalg.inv(h).T
    np.testing.assert_allclose(ekf.birth_covariance(jacobian, noise), _components(born), rtol=1e-9, atol=1e-9)
    nu = rng.normal(size=2)
    square, determinant = mahalanobis_square(nu, small)
    np.testing.assert_allclose(square, nu @ np.linalg.solve(covariance, nu), rtol=1e-9)
    np.testing.assert_allclose(determinant, np.linalg.det(covariance), rtol=1e-9)


@given(SEEDS)
def test_the_likelihoods_of_eq_17_and_18_are_normalised_gaussians(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covariance, innovation = _covariance(rng), rng.normal(size=2)
    expected = multivariate_normal(np.zeros(2), covariance).logpdf(innovation)
    assert gaussian_log_likelihood(innovation, _components(covariance)) == pytest.approx(expected, rel=1e-9)


def test_weights_multiply_over_all_measurements_and_an_outlier_is_floored() -> None:
    log_likelihoods = np.array([[-1.0, -3.0], [-2.0, -4.0]])
    np.testing.assert_allclose(combine(np.array([0.5, 0.0]), log_likelihoods, 1.0), [-2.5, -7.0])
    np.testing.assert_allclose(combine(np.zeros(2), log_likelihoods, 0.5), [-1.5, -3.5])
    floored = robust_log_likelihood(np.array([-1e6]), log_clutter=-5.0, outlier_share=0.02)
    np.testing.assert_allclose(floored, np.log(0.02) - 5.0)


@given(arrays(float, st.integers(1, 60), elements=st.floats(1e-6, 1.0)), SEEDS)
def test_systematic_resampling_draws_each_particle_its_share_rounded(raw: np.ndarray, seed: int) -> None:
    weights = raw / raw.sum()
    counts = np.bincount(systematic(weights, np.random.default_rng(seed)), minlength=len(weights))
    share = len(weights) * weights
    assert counts.sum() == len(weights)
    assert np.all((counts >= np.floor(share - 1e-9)) & (counts <= np.ceil(share + 1e-9)))


def test_resampling_is_unbiased() -> None:
    rng = np.random.default_rng(5)
    weights = np.array([0.05, 0.1, 0.2, 0.65])
    counts = sum(np.bincount(systematic(weights, rng), minlength=4) for _ in range(20_000))
    np.testing.assert_allclose(counts / counts.sum(), weights, atol=2e-3)


def _cloud(count: int, rng: np.random.Generator) -> Particles:
    return Particles.sample(count, 1, position_std=2.0, heading=3.1, heading_std=0.2, noise=MotionNoise(), rng=rng)


def test_effective_number_is_m_for_even_weights_and_one_for_a_single_survivor() -> None:
    particles = _cloud(50, np.random.default_rng(0))
    assert particles.effective == pytest.approx(50.0)
    particles.log_weight = np.where(np.arange(50) == 7, 0.0, -1e4)
    assert particles.effective == pytest.approx(1.0)


def test_resampling_waits_for_degeneracy_and_then_evens_the_weights() -> None:
    rng = np.random.default_rng(1)
    particles = _cloud(100, rng)
    assert not resample(particles, 0.5, 0.2, rng)
    particles.log_weight = -0.5 * (particles.state[0] / 0.2) ** 2
    assert resample(particles, 0.5, 0.2, rng)
    assert particles.effective == pytest.approx(100.0)


def test_the_jitter_keeps_mean_and_covariance_across_the_wrap_of_the_heading() -> None:
    rng = np.random.default_rng(2)
    particles = _cloud(100, rng)
    particles.log_weight = -0.5 * (particles.state[0] - 2.0) ** 2
    mean, covariance = particles.mean_state()
    covariance *= 0.99 / (1.0 - 1.0 / particles.effective)  # what uneven weights take from it
    assert resample(particles, 1.0, 0.4, rng)
    after_mean, after_covariance = particles.mean_state()
    std = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(wrap_angle(after_mean - mean) / std, 0.0, atol=1e-6)
    np.testing.assert_allclose(after_covariance / np.outer(std, std), covariance / np.outer(std, std), atol=1e-6)


def test_weights_that_say_nothing_leave_the_cloud_as_wide_as_it_was() -> None:
    kept = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        particles = _cloud(100, rng)
        before = particles.mean_state()[1].diagonal()
        for _ in range(60):
            particles.log_weight = rng.standard_normal(100)
            assert resample(particles, 0.9, 0.6, rng)
        kept.append(particles.mean_state()[1].diagonal() / before)
    assert np.mean(kept) == pytest.approx(1.0, abs=0.25)


def test_what_hangs_on_the_path_moves_along_with_a_copy_that_is_spread() -> None:
    rng = np.random.default_rng(3)
    particles = _cloud(200, rng)
    particles.gnss_bias = -particles.state[:2]  # fixes have told the sum of place and bias, and nothing else
    particles.calibration[1] = 0.01 - particles.state[2]
    particles.means[:, 0] = particles.state[:2] + 30.0
    particles.log_weight = -0.5 * particles.state[0] ** 2
    assert resample(particles, 1.0, 0.9, rng)
    np.testing.assert_allclose(particles.state[:2] + particles.gnss_bias, 0.0, atol=1e-3)
    np.testing.assert_allclose(wrap_angle(particles.state[2] + particles.calibration[1] - 0.01), 0.0, atol=1e-3)
    np.testing.assert_allclose(particles.means[:, 0] - particles.state[:2], 30.0, atol=1e-3)


@pytest.mark.parametrize(("start_std", "spread"), [(1.5, (0.85, 1.01)), (10.0, (0.1, 0.3)), (0.1, (0.9, 1.01))])
def test_fixes_at_the_start_tell_no_more_than_the_start_did(start_std: float, spread: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    particles = Particles.sample(
        4000, 1, position_std=start_std, heading=0.0, heading_std=0.1, noise=MotionNoise(), rng=rng
    )
    bias = GnssBias(FilterParameters(), start_std)
    for second in range(10):
        bias.update(particles, float(second), np.zeros(2), 1.5)
    low, high = spread
    assert low < np.sqrt(particles.place_covariance()[0]) / start_std < high


@given(SEEDS)
def test_several_features_of_one_frame_teach_the_calibration_what_bayes_rule_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    particles, calibration = _cloud(3, rng), SensorCalibration(Calibrations(FilterParameters()))
    distance, noise = rng.uniform(5.0, 80.0, 4), rng.uniform(1e-5, 4.0, (2, 4))
    innovation = rng.normal(size=(2, 4, 3)) * np.sqrt(noise)[:, :, None]
    prior = calibration.variance.copy()
    calibration.update(particles, innovation, distance, noise)
    for part, by_constant in enumerate((distance, np.ones(4))):
        variance = 1.0 / (1.0 / prior[part] + (by_constant**2 / noise[part]).sum())
        assert calibration.variance[part] == pytest.approx(variance)
        expected = variance * (by_constant / noise[part]) @ innovation[part]
        np.testing.assert_allclose(particles.calibration[part], expected, rtol=1e-6, atol=1e-12)


@given(SEEDS, st.integers(1, 30), st.integers(0, 8))
def test_the_assignment_is_the_best_one_to_one(seed: int, detections: int, features: int) -> None:
    rng = np.random.default_rng(seed)
    score = rng.normal(1.0, 2.0, (detections, features))
    score[rng.random(score.shape) < 0.3] = -np.inf
    chosen = assign(score)
    pairs = [(d, f) for d, f in enumerate(chosen.tolist()) if f >= 0]
    assert len({f for _, f in pairs}) == len(pairs)
    gain = np.concatenate([np.maximum(score, 0.0), np.zeros((detections, detections))], axis=1)
    rows, columns = linear_sum_assignment(gain, maximize=True)
    assert sum(score[d, f] for d, f in pairs) == pytest.approx(gain[rows, columns].sum())
