"""The measurement in the proposal (FastSLAM 2.0, Montemerlo and others 2003): sample where the noise and z agree.

The motion prior of eq. 12 wastes particles where odometry is coarse and sensors are sharp. Here each particle's pending
pose noise is first conditioned on the measurements, and the weight of eq. 19 becomes the likelihood of the measurements
with that noise integrated out. The noise has two sources, distance and turn, so all matrices are 2×2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.ekf import apply, full, product, transpose
from slamcu_core.filter.particles import Particles
from slamcu_core.geometry import inverse, mahalanobis_square

Array = NDArray[np.float64]


@dataclass(slots=True)
class PendingNoise:
    """What measurements have told so far of the standard normal noise that is pending of M poses."""

    mean: Array  # (K, M)
    spread: Array  # (K, K, M), its covariance

    @classmethod
    def untold(cls, noises: int, count: int) -> PendingNoise:
        """Return what is known of K noises of M poses before any measurement."""
        spread = np.zeros((noises, noises, count))
        spread[np.arange(noises), np.arange(noises)] = 1.0
        return cls(np.zeros((noises, count)), spread)

    def foresee(
        self, by_noise: Array, innovation: Array, covariance: Array
    ) -> tuple[Array, tuple[Array, Array, Array], Array]:
        """Return the innovation (2, ..., M) of a measurement or several, its covariance, and that with the noise.

        `by_noise` (2, K, ..., M) is the Jacobian, `innovation` and `covariance` (3, ..., M) are without the noise.
        """
        each = (None,) * (by_noise.ndim - 3)
        nu = innovation - apply(by_noise, self.mean[:, *each])
        across = product(self.spread[:, :, *each], transpose(by_noise))
        (xx, xy), (_, yy) = product(by_noise, across)
        return nu, (xx + covariance[0], xy + covariance[1], yy + covariance[2]), across

    def learn(self, nu: Array, q: Sequence[Array] | Array, across: Array, taken: NDArray[np.bool_]) -> None:
        """Condition on one measurement as it was foreseen, where it is `taken` (M,)."""
        gain = product(across, full(inverse(q))) * taken
        self.mean = self.mean + apply(gain, nu)
        self.spread = self.spread - product(gain, transpose(across))


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
    noise = PendingNoise.untold(by_noise.shape[1], count)
    for index in range(measurements):
        nu, q, across = noise.foresee(by_noise[:, :, index], innovation[:, index], covariance[:, index])
        square, determinant = mahalanobis_square(nu, q)
        log_likelihood[index] = -0.5 * square - np.log(2.0 * np.pi) - 0.5 * np.log(determinant)
        noise.learn(nu, q, across, square < gate)
    particles.settle_conditioned(noise.mean, noise.spread, rng)
    return log_likelihood
