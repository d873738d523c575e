"""The measurement in the proposal (FastSLAM 2.0, Montemerlo and others 2003): sample where the noise and z agree.

The motion prior of eq. 12 wastes particles where odometry is coarse and sensors are sharp. Here each particle's pending
pose noise N(x, P) is first conditioned on the measurements, and the weight of eq. 19 becomes the likelihood of the
measurements with P integrated out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.ekf import inverse_2x2
from slamcu_core.filter.particles import Particles

Array = NDArray[np.float64]


def pays(jacobian: Array, pending: Array, covariance: Array) -> bool:
    """Return whether conditioning is worth its time: the pending noise shows in the measurement at all.

    Parameters
    ----------
    jacobian : (M, A, 2, 3) with respect to the pose.
    pending : (M, 3, 3).
    covariance : (M, A, 2, 2) of the innovations, without the pending noise.
    """
    spread = np.einsum("kaij,kjl,kail->kai", jacobian, pending, jacobian)
    noise = np.diagonal(covariance, axis1=-2, axis2=-1)
    return bool((spread / noise).mean(axis=(0, 1)).max() > 0.1)


def condition(particles: Particles, jacobian: Array, innovation: Array, covariance: Array, gate: float) -> Array:
    """Condition pending poses on A measurements one after the other, in place.

    Parameters
    ----------
    jacobian : (M, A, 2, 3) with respect to the pose, at the predicted pose.
    innovation : (M, A, 2) z - ẑ at the predicted pose.
    covariance : (M, A, 2, 2) of the innovations, without the pending noise.
    gate : chi-square threshold beyond which a particle takes a measurement as somebody else's.

    Returns
    -------
    Log likelihoods (M, A) with the pending noise integrated out.
    """
    count, measurements = innovation.shape[:2]
    log_likelihood = np.empty((count, measurements))
    moved = np.zeros((count, 3))
    pending = particles.pending
    for index in range(measurements):
        h = jacobian[:, index]
        nu = innovation[:, index] - (h @ moved[..., None])[..., 0]
        across = pending @ np.swapaxes(h, -1, -2)
        inverse, determinant = inverse_2x2(h @ across + covariance[:, index])
        square = np.einsum("ki,kij,kj->k", nu, inverse, nu)
        log_likelihood[:, index] = -0.5 * square - np.log(2.0 * np.pi) - 0.5 * np.log(determinant)
        gain = across @ inverse * (square < gate)[:, None, None]
        moved += (gain @ nu[..., None])[..., 0]
        pending = pending - gain @ np.swapaxes(across, -1, -2)
    particles.state[:, :3] += moved
    particles.pending = pending
    return log_likelihood
