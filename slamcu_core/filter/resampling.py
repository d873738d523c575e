"""Resampling, eq. 20 with its erratum, regularised so that constants of the vehicle stay explorable."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.particles import Particles
from slamcu_core.geometry import wrap_angle

Array = NDArray[np.float64]


def systematic(weights: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return M ancestors drawn by systematic resampling from normalised weights (M,).

    Each particle k is drawn floor(M ω_k) or ceil(M ω_k) times, M ω_k on average.
    """
    count = len(weights)
    cumulative = np.cumsum(weights)
    cumulative[-1] = 1.0
    return np.searchsorted(cumulative, (rng.random() + np.arange(count)) / count, side="right").astype(np.intp)


def resample(particles: Particles, fraction: float, jitter: float, rng: np.random.Generator) -> bool:
    """Resample in place if M_eff < α M (eq. 20); return whether it was done.

    Copies are spread again by a Gaussian kernel of `jitter` standard deviations of the cloud after shrinking the
    cloud towards its mean by sqrt(1 - jitter²), which keeps mean and covariance (Liu and West 2001).
    """
    if particles.effective >= fraction * len(particles):
        return False
    mean, covariance = particles.mean_state()
    particles.select(systematic(particles.weights, rng))
    if jitter > 0.0:
        delta = particles.state - mean[:, None]
        delta[2] = wrap_angle(delta[2])
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        noise = root @ rng.standard_normal((len(particles), len(mean))).T
        particles.state = mean[:, None] + np.sqrt(1.0 - jitter**2) * delta + jitter * noise
    return True
