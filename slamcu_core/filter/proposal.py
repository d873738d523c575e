"""The measurement in the proposal (FastSLAM 2.0, Montemerlo and others 2003): sample where the noise and z agree.

The motion prior of eq. 12 wastes particles where odometry is coarse and sensors are sharp. Here each particle's pending
pose noise is first conditioned on the measurements, and the weight of eq. 19 becomes the likelihood of the measurements
with that noise integrated out. The noise has two sources, distance and turn, so all matrices are 2×2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.ekf import inverse_2x2
from slamcu_core.filter.particles import Particles

Array = NDArray[np.float64]


def noise_jacobian(by_pose: Array, pending: Array) -> Array:
    """Return the Jacobian (M, A, 2, 2) of measurements with respect to the standard normal noise that is pending.

    `by_pose` is ∂h/∂x (M, A, 2, 3) at the predicted pose, `pending` the factor (M, 3, 2) of the pose's noise.
    """
    return np.asarray(by_pose @ pending[:, None])


def pays(by_noise: Array, covariance: Array) -> bool:
    """Return whether conditioning is worth its time: the pending noise shows in the measurement at all.

    `covariance` (M, A, 2, 2) is that of the innovations, without the pending noise.
    """
    spread = np.sum(by_noise**2, axis=-1)
    return bool((spread / np.diagonal(covariance, axis1=-2, axis2=-1)).mean(axis=(0, 1)).max() > 0.1)


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
    by_noise : (M, A, 2, 2) Jacobian with respect to the pending noise.
    innovation : (M, A, 2) z - ẑ at the predicted pose.
    covariance : (M, A, 2, 2) of the innovations, without the pending noise.
    gate : chi-square threshold beyond which a particle takes a measurement as somebody else's.

    Returns
    -------
    Log likelihoods (M, A) with the pending noise integrated out.
    """
    assert particles.pending is not None  # noqa: S101 - by_noise was made from it
    count, measurements = innovation.shape[:2]
    log_likelihood = np.empty((count, measurements))
    mean = np.zeros((count, 2))
    spread = np.broadcast_to(np.eye(2), (count, 2, 2))
    for index in range(measurements):
        h = by_noise[:, index]
        nu = innovation[:, index] - (h @ mean[..., None])[..., 0]
        across = spread @ np.swapaxes(h, -1, -2)
        inverse, determinant = inverse_2x2(h @ across + covariance[:, index])
        square = np.einsum("ki,kij,kj->k", nu, inverse, nu)
        log_likelihood[:, index] = -0.5 * square - np.log(2.0 * np.pi) - 0.5 * np.log(determinant)
        gain = across @ inverse * (square < gate)[:, None, None]
        mean = mean + (gain @ nu[..., None])[..., 0]
        spread = spread - gain @ np.swapaxes(across, -1, -2)
    draw = rng.standard_normal((count, 2))
    first = np.sqrt(np.maximum(spread[:, 0, 0], 1e-12))
    second = spread[:, 1, 0] / first
    third = np.sqrt(np.maximum(spread[:, 1, 1] - second**2, 0.0))
    mean[:, 1] += second * draw[:, 0] + third * draw[:, 1]
    mean[:, 0] += first * draw[:, 0]
    particles.state[:, :3] += (particles.pending @ mean[..., None])[..., 0]
    particles.pending = None
    return log_likelihood
