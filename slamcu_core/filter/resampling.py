"""Resampling, eq. 20 with its erratum, regularised so that constants of the vehicle stay explorable."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.particles import Particles
from slamcu_core.geometry import wrap_angle

Array = NDArray[np.float64]


def systematic(weights: Array, rng: np.random.Generator, count: int | None = None) -> NDArray[np.intp]:
    """Return M or `count` ancestors drawn by systematic resampling from normalised weights (M,).

    Each particle k is drawn floor(M ω_k) or ceil(M ω_k) times, M ω_k on average.
    """
    count = len(weights) if count is None else count
    cumulative = np.cumsum(weights)
    cumulative[-1] = 1.0
    return np.searchsorted(cumulative, (rng.random() + np.arange(count)) / count, side="right").astype(np.intp)


def resample(
    particles: Particles, fraction: float, jitter: float, rng: np.random.Generator, *, leave_open: bool = False
) -> bool:
    """Resample in place if M_eff < α M (eq. 20); return whether it was done.

    Copies are spread again by a Gaussian kernel of `jitter` standard deviations of the cloud after shrinking the
    cloud towards its mean by sqrt(1 - jitter²), which keeps mean and covariance (Liu and West 2001): exactly, for what
    chance adds to them at each resampling would add up, and with what it takes from the covariance (`_lost`). What a
    particle holds as Gaussians given its path moves along.

    With `leave_open` the pose's part of the kernel waits for the next measurement. Where the cloud is in two minds it
    is as wide as they are apart; sampled at once, it would throw copies out of both.
    """
    if particles.effective >= fraction * len(particles):
        return False
    weights = particles.weights
    mean, covariance = particles.mean_state()
    wider = _lost(weights)
    std = np.sqrt(np.maximum(covariance.diagonal(), 1e-30))
    correlation = covariance / np.outer(std, std) + 1e-9 * np.eye(len(std))
    moved_along = jitter > 0.0 and not leave_open
    follows = _regression(particles, weights, mean, correlation, std) if moved_along else None
    particles.select(systematic(weights, rng))
    if jitter > 0.0:
        delta = particles.state - mean[:, None]
        delta[2] = wrap_angle(delta[2])
        if follows is None:
            particles.state += (np.sqrt(1.0 - jitter**2) - 1.0) * delta
            _spread_later(particles, (wider - 1.0 + jitter**2) * correlation * np.outer(std, std), rng)
            return True
        root = np.linalg.cholesky(correlation)  # no eigenvectors: their signs are rounding's to choose
        spread = np.sqrt(1.0 - jitter**2) * delta / std[:, None] + jitter * (root @ rng.standard_normal(delta.shape))
        shift = _having(spread, math.sqrt(wider) * root) * std[:, None] - delta
        particles.state += shift
        _follow(particles, follows @ shift)
    return True


def _lost(weights: Array) -> float:
    """Return by how much weights (M,) make a sample's covariance too small, on average.

    Uneven weights move its mean, and what it has moved is missing in its spread: a hundredth at half of the particles
    effective, at every resampling, which in half a minute of fixes is a fifth.
    """
    even = 1.0 / len(weights)
    return (1.0 - even) / max(1.0 - float(weights @ weights), even)


def _having(sample: Array, root: Array) -> Array:
    """Return a sample (K, M) shifted and stretched so that its mean is 0 and its covariance root rootᵀ."""
    centred = sample - sample.mean(axis=1, keepdims=True)
    covariance = centred @ centred.T / sample.shape[1] + 1e-9 * np.eye(len(sample))
    return np.asarray(root @ np.linalg.solve(np.linalg.cholesky(covariance), centred))


def _regression(particles: Particles, weights: Array, mean: Array, correlation: Array, std: Array) -> Array:
    """Return how what hangs on the path follows the sampled state in the cloud, (K, 6).

    A heading and the bearing bias make up for each other, as do a place and the satellite receiver's bias or a find's
    place: a copy that is moved without them would contradict what its ancestor has learnt.
    """
    hanging = _hanging(particles)
    state = particles.state - mean[:, None]
    state[2] = wrap_angle(state[2])
    state /= std[:, None]
    cross = (state * weights) @ (hanging - (hanging @ weights)[:, None]).T
    return np.asarray(np.linalg.solve(correlation, cross).T / std)


def _hanging(particles: Particles) -> Array:
    """Return the means (K, M) of what is Gaussian given a particle's path."""
    means = particles.means.reshape(-1, len(particles))
    return np.concatenate([particles.gnss_bias, particles.calibration, means])


def _follow(particles: Particles, shift: Array) -> None:
    """Shift what `_hanging` returns by (K, M), in place."""
    particles.gnss_bias += shift[:2]
    means = 2 + len(particles.calibration)
    particles.calibration += shift[2:means]
    particles.means += shift[means:].reshape(particles.means.shape)


def _spread_later(particles: Particles, kernel: Array, rng: np.random.Generator) -> None:
    """Spread the vehicle's constants by a kernel (6, 6) now and leave the pose's part, given theirs, open; in place."""
    order = np.array([3, 4, 5, 0, 1, 2])
    std = np.sqrt(kernel.diagonal())[order]
    root = std[:, None] * np.linalg.cholesky(kernel[np.ix_(order, order)] / np.outer(std, std))
    particles.state[order] += root[:, :3] @ rng.standard_normal((3, len(particles)))
    particles.leave_open(root[3:, 3:])
