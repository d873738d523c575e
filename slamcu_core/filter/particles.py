"""The particles of eq. 11 as arrays: poses, what each vehicle has constantly wrong, and Gaussians of new features."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_core.geometry import wrap_angle
from slamcu_core.models import MotionNoise

Array = NDArray[np.float64]


@dataclass(slots=True)
class Particles:
    """M particles with up to L live new features (eq. 11, 13).

    The columns of `state` are sampled: x, y (m), heading (rad), speed scale, yaw scale, yaw bias (rad/s). The rest is
    Rao-Blackwellized: given a particle's path it is Gaussian, with its mean kept here.
    """

    state: Array  # (M, 6)
    log_weight: Array  # (M,), unnormalised
    mean: Array  # (M, L, 2) means μ of new features, m
    covariance: Array  # (M, L, 2, 2) covariances Σ of new features, m²
    gnss_bias: Array  # (M, 2) mean of the satellite receiver's bias, m
    calibration: Array  # (M, 2) mean range scale error and bearing bias (rad)
    pending: Array | None = None  # (M, 3, 2): the pose waits for this times a standard normal (2,) to be added

    @classmethod
    def sample(
        cls,
        count: int,
        slots: int,
        *,
        position_std: float,
        heading: float,
        heading_std: float,
        noise: MotionNoise,
        rng: np.random.Generator,
    ) -> Particles:
        """Draw particles around the origin of the local frame with the given heading (rad)."""
        mean = np.array([0.0, 0.0, heading, 1.0, 1.0, 0.0])
        std = np.concatenate([[position_std, position_std, heading_std], noise.constants_std])
        return cls(
            state=mean + std * rng.standard_normal((count, 6)),
            log_weight=np.zeros(count),
            mean=np.zeros((count, slots, 2)),
            covariance=np.zeros((count, slots, 2, 2)),
            gnss_bias=np.zeros((count, 2)),
            calibration=np.zeros((count, 2)),
        )

    def __len__(self) -> int:
        return len(self.state)

    @property
    def pose(self) -> Array:
        """Poses (M, 3) of x, y, heading."""
        return self.state[:, :3]

    @property
    def weights(self) -> Array:
        """Normalised weights (M,)."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(weight / weight.sum())

    @property
    def effective(self) -> float:
        """Effective number of particles, 1 / Σ ω² on normalised weights (eq. 20 with its erratum)."""
        return float(1.0 / np.sum(self.weights**2))

    def mean_state(self) -> tuple[Array, Array]:
        """Return the weighted mean (6,) and covariance (6, 6) of the sampled state, headings averaged as angles."""
        weights = self.weights
        reference = self.state[int(np.argmax(weights))]
        delta = self.state - reference
        delta[:, 2] = wrap_angle(delta[:, 2])
        offset = weights @ delta
        centred = delta - offset
        mean = reference + offset
        mean[2] = wrap_angle(float(mean[2]))
        covariance = (centred * weights[:, None]).T @ centred
        covariance[:3, :3] += self.pending_covariance()
        return mean, covariance

    def pending_covariance(self) -> Array:
        """Return the covariance (3, 3) that waits to be sampled, averaged over the particles."""
        if self.pending is None:
            return np.zeros((3, 3))
        return np.asarray(np.einsum("k,kia,kja->ij", self.weights, self.pending, self.pending))

    def settle(self, rng: np.random.Generator) -> None:
        """Sample what is pending of the poses, in place."""
        if self.pending is not None:
            draw = rng.standard_normal((len(self), 2, 1))
            self.state[:, :3] += (self.pending @ draw)[..., 0]
            self.pending = None

    def restart(
        self, place: Array, heading: float, position_std: float, heading_std: float, rng: np.random.Generator
    ) -> None:
        """Spread all particles anew about a pose, in place; what they know of the vehicle stays."""
        count = len(self)
        self.state[:, :2] = place + position_std * rng.standard_normal((count, 2))
        self.state[:, 2] = heading + heading_std * rng.standard_normal(count)
        self.log_weight = np.zeros(count)
        self.pending = None

    def select(self, index: NDArray[np.intp]) -> None:
        """Replace the particles by copies of those at `index` (M,), all of equal weight."""
        self.state = self.state[index]
        self.mean = self.mean[index]
        self.covariance = self.covariance[index]
        self.gnss_bias = self.gnss_bias[index]
        self.calibration = self.calibration[index]
        if self.pending is not None:
            self.pending = self.pending[index]
        self.log_weight = np.zeros(len(index))

    def collapse(self, slot: int) -> tuple[Array, Array]:
        """Return mean (2,) and covariance (2, 2) of one new feature over all particles: the moments of the mixture."""
        weights = self.weights
        mean = weights @ self.mean[:, slot]
        spread = self.mean[:, slot] - mean
        covariance = np.einsum("k,kij->ij", weights, self.covariance[:, slot])
        return mean, covariance + (spread * weights[:, None]).T @ spread
