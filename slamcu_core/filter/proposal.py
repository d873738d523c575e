"""The measurement in the proposal (FastSLAM 2.0, Montemerlo and others 2003): sample where the noise and z agree.

The motion prior of eq. 12 wastes particles where odometry is coarse and sensors are sharp. Here each particle's pending
pose noise is first conditioned on the measurements, and the weight of eq. 19 becomes the likelihood of the measurements
with that noise integrated out. The noise has two sources, distance and turn, so all matrices are 2×2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.ekf import apply, full, inverse, mahalanobis_square, product, transpose
from slamcu_core.filter.particles import Particles

Array = NDArray[np.float64]


def noise_jacobian(by_pose: Array, pending: Array) -> Array:
    """Return the Jacobian (2, K, A, M) of measurements with respect to the standard normal noise that is pending.

    `by_pose` is ∂h/∂x (2, 3, A, M) at the predicted pose, `pending` the factor (3, K, M) of the pose's noise.
    """
    return product(by_pose, pending[:, :, None])


def pays(spread: Array, variance: Array) -> bool:
    """Return whether conditioning is worth its time: the pending noise shows in the measurements at all.

    `spread` (2, A) is the variance that the pending noise gives the measurements, `variance` (2, A) that of the
    innovations without it.
    """
    shares = np.add.reduce(spread / variance, axis=1) / spread.shape[1]
    return bool(shares.max() > 0.1)


def condition(
    particles: Particles,
    by_noise: Array,
    innovation: Array,
    covariance: Array,
    *,
    gate: float,
    rng: np.random.Generator,
) -> Array:
    """Sample pending poses conditioned on A measurements, taken one after the other, in place.

    Parameters
    ----------
    by_noise : (2, K, A, M) Jacobian with respect to the pending noise.
    innovation : (2, A, M) z - ẑ at the predicted pose.
    covariance : (3, A, M) of the innovations, without the pending noise.
    gate : chi-square threshold beyond which a particle takes a measurement as somebody else's.

    Returns
    -------
    Log likelihoods (A, M) with the pending noise integrated out.
    """
    assert particles.pending is not None  # noqa: S101 - by_noise was made from it
    measurements, count = innovation.shape[1:]
    log_likelihood = np.empty((measurements, count))
    noises = by_noise.shape[1]
    mean, spread = np.zeros((noises, count)), np.zeros((noises, noises, count))
    spread[np.arange(noises), np.arange(noises)] = 1.0
    for index in range(measurements):
        h = by_noise[:, :, index]
        nu = innovation[:, index] - apply(h, mean)
        across = product(spread, transpose(h))
        (q00, q01), (_, q11) = product(h, across)
        q = q00 + covariance[0, index], q01 + covariance[1, index], q11 + covariance[2, index]
        square, determinant = mahalanobis_square(nu, q)
        log_likelihood[index] = -0.5 * square - np.log(2.0 * np.pi) - 0.5 * np.log(determinant)
        gain = product(across, full(inverse(q))) * (square < gate)
        mean = mean + apply(gain, nu)
        spread = spread - product(gain, transpose(across))
    particles.settle_conditioned(mean, spread, rng)
    return log_likelihood
