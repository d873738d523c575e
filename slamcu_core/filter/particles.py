"""The particles of eq. 11 as arrays: poses, what each vehicle has constantly wrong, and Gaussians of new features."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.ekf import apply
from slamcu_core.geometry import wrap_angle
from slamcu_core.models import MotionNoise

Array = NDArray[np.float64]


class Cloud(NamedTuple):
    """The poses of the particles: weights (M,), mean (3,), and what each differs from it (3, M)."""

    weights: Array
    mean: Array
    delta: Array

    @property
    def covariance(self) -> Array:
        """The covariance (3, 3) of the poses, without what is pending."""
        return np.asarray((self.delta * self.weights) @ self.delta.T)


@dataclass(slots=True)
class Particles:
    """M particles with up to L live new features (eq. 11, 13).

    Arrays over features and particles have the particles last and components first, so that what is done for all
    particles runs along memory. The rows of `state` are sampled: x, y (m), heading (rad), speed scale, yaw scale,
    yaw bias (rad/s). The rest is Rao-Blackwellized: given a particle's path it is Gaussian, with its mean kept here.
    """

    state: Array  # (6, M)
    log_weight: Array  # (M,), unnormalised
    means: Array  # (2, L, M) means μ of new features, m
    covariances: Array  # (3, L, M) xx, xy, yy of the covariances Σ of new features, m²
    gnss_bias: Array  # (2, M) mean of the satellite receiver's bias, m
    calibration: Array  # (2 S, M) mean range scale error and bearing bias (rad) of each sensor
    grip: Array  # (M,) share of the motion told by odometry that is made; 1 while nothing slips
    pending: Array | None = None  # (3, K, M): the pose waits for this times a standard normal (K,) to be added
    _weights: tuple[Array, Array] | None = field(default=None, init=False)  # of which `log_weight`, and they

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
        sensors: int = 1,
    ) -> Particles:
        """Draw particles around the origin of the local frame with the given heading (rad)."""
        mean = np.array([0.0, 0.0, heading, 1.0, 1.0, 0.0])
        std = np.concatenate([[position_std, position_std, heading_std], noise.constants_std])
        state = (mean + std * rng.standard_normal((count, 6))).T.copy()
        return cls(
            state=state,
            log_weight=np.zeros(count),
            means=np.zeros((2, slots, count)),
            covariances=np.zeros((3, slots, count)),
            gnss_bias=-state[:2],  # what the start has wrong; see `GnssBias`
            calibration=np.zeros((2 * sensors, count)),
            grip=np.ones(count),
        )

    def __len__(self) -> int:
        return len(self.log_weight)

    @property
    def pose(self) -> Array:
        """Poses (3, M) of x, y, heading."""
        return self.state[:3]

    @property
    def weights(self) -> Array:
        """Normalised weights (M,); once asked for, `log_weight` can be replaced but no longer changed in place."""
        if self._weights is not None and self._weights[0] is self.log_weight:
            return self._weights[1]
        weights: Array = np.exp(self.log_weight - np.maximum.reduce(self.log_weight))
        weights /= np.add.reduce(weights)
        self.log_weight.setflags(write=False)
        weights.setflags(write=False)
        self._weights = self.log_weight, weights
        return weights

    @property
    def even(self) -> Array:
        """Weights (M,) of particles that all count the same."""
        return _even(len(self.log_weight))

    def __getstate__(self) -> dict[str, object]:
        return {item.name: getattr(self, item.name) for item in fields(self) if item.name != "_weights"}

    def __setstate__(self, state: dict[str, object]) -> None:
        self._weights = None
        for name, value in state.items():
            setattr(self, name, value)

    @property
    def effective(self) -> float:
        """Effective number of particles, 1 / Σ ω² on normalised weights (eq. 20 with its erratum)."""
        weights = self.weights
        return float(1.0 / (weights @ weights))

    def mean_state(self) -> tuple[Array, Array]:
        """Return the weighted mean (6,) and covariance (6, 6) of the sampled state, headings averaged as angles."""
        weights = self.weights
        reference, delta, offset = self._about_the_best(weights)
        delta -= offset[:, None]
        mean = reference + offset
        mean[2] = wrap_angle(float(mean[2]))
        covariance = (delta * weights) @ delta.T
        covariance[:3, :3] += self.pending_covariance(weights)
        return mean, covariance

    def place_covariance(self) -> Array:
        """Return the covariance (3,) of the position, m²."""
        weights = self.weights
        delta = self.state[:2] - (self.state[:2] @ weights)[:, None]
        covariance = (delta * weights) @ delta.T
        if self.pending is not None:
            covariance += self.pending_covariance(weights)[:2, :2]
        return np.asarray(covariance.take((0, 1, 3)))

    def cloud(self) -> Cloud:
        """Return the poses as a cloud about their weighted mean, headings averaged as angles."""
        weights = self.weights
        reference, delta, offset = self._about_the_best(weights, 3)
        delta -= offset[:, None]
        mean = reference + offset
        mean[2] = wrap_angle(float(mean[2]))
        return Cloud(weights, mean, delta)

    def _about_the_best(self, weights: Array, rows: int = 6) -> tuple[Array, Array, Array]:
        """Return the best particle's state up to `rows`, what all (rows, M) differ from it, and the mean of that."""
        state = self.state[:rows]
        reference = state[:, int(weights.argmax())]
        delta = state - reference[:, None]
        delta[2] = wrap_angle(delta[2])
        return reference, delta, delta @ weights

    def pending_covariance(self, weights: Array) -> Array:
        """Return the covariance (3, 3) that waits to be sampled, averaged over the particles."""
        if self.pending is None:
            return np.zeros((3, 3))
        return np.asarray((self.pending * weights).reshape(3, -1) @ self.pending.reshape(3, -1).T)

    def settle(self, rng: np.random.Generator) -> None:
        """Sample what is pending of the poses, in place."""
        if self.pending is not None:
            draw = rng.standard_normal((len(self), self.pending.shape[1]))
            self.state[:3] += apply(self.pending, draw.T)
            self.pending = None

    def settle_conditioned(self, mean: Array, spread: Array, rng: np.random.Generator) -> None:
        """Sample what is pending from normals of mean (K, M) and covariance (K, K, M) in place of standard ones."""
        assert self.pending is not None  # noqa: S101 - what it was conditioned on was made from it
        draw = rng.standard_normal((len(self), len(mean))).T
        if len(mean) == 2:
            first = np.sqrt(np.maximum(spread[0, 0], 1e-12))
            second = spread[1, 0] / first
            third = np.sqrt(np.maximum(spread[1, 1] - second**2, 0.0))
            noise = mean + np.array([first * draw[0], second * draw[0] + third * draw[1]])
        else:
            root = np.asarray(np.linalg.cholesky(spread.transpose(2, 0, 1) + 1e-9 * np.eye(len(mean))), float)
            noise = mean + apply(root.transpose(1, 2, 0), draw)
        self.state[:3] += apply(self.pending, noise)
        self.pending = None

    def leave_open(self, factor: Array) -> None:
        """Let the pose wait for noise of covariance F Fᵀ, F (3, 3), the same for all."""
        self.pending = np.repeat(factor[:, :, None], len(self), axis=2)

    @property
    def left_open(self) -> Array | None:
        """The noise (3, 3, M) that was left open, if no motion has added its own (3, 2, M) or (3, 5, M) since."""
        return self.pending if self.pending is not None and self.pending.shape[1] == 3 else None

    def many(
        self, factor: int, width: float, rng: np.random.Generator, slots: NDArray[np.intp] | None = None
    ) -> Particles:
        """Return `factor` times as many particles, drawn from kernels a share of the cloud wide about these.

        Poses shrink towards their mean so that the cloud keeps its covariance (Liu and West 2001). Particle k comes
        from particle k // factor; what waits to be sampled is sampled. Of new features they know those in `slots`;
        None: all.
        """
        self.settle(rng)
        mean, covariance = self.mean_state()
        known = slice(None) if slots is None else slots
        means, covariances = (
            np.empty((*held.shape[:2], factor * len(self))) for held in (self.means, self.covariances)
        )
        means[:, known] = np.repeat(self.means[:, known], factor, axis=2)
        covariances[:, known] = np.repeat(self.covariances[:, known], factor, axis=2)
        many = Particles(
            state=np.repeat(self.state, factor, axis=1),
            log_weight=np.repeat(self.log_weight, factor),
            means=means,
            covariances=covariances,
            gnss_bias=np.repeat(self.gnss_bias, factor, axis=1),
            calibration=np.repeat(self.calibration, factor, axis=1),
            grip=np.repeat(self.grip, factor),
        )
        delta = many.state[:3] - mean[:3, None]
        delta[2] = wrap_angle(delta[2])
        noise = _root(covariance[:3, :3]) @ rng.standard_normal(delta.shape)
        many.state[:3] = mean[:3, None] + math.sqrt(1.0 - width**2) * delta + width * noise
        return many

    def part(self, start: int, end: int) -> Particles:
        """Return the particles from `start` to before `end`, as views of these."""
        some = slice(start, end)
        return Particles(
            state=self.state[:, some],
            log_weight=self.log_weight[some],
            means=self.means[:, :, some],
            covariances=self.covariances[:, :, some],
            gnss_bias=self.gnss_bias[:, some],
            calibration=self.calibration[:, some],
            grip=self.grip[some],
            pending=None if self.pending is None else self.pending[:, :, some],
        )

    def stray(self, of: Particles, probability: float, share: float, width: float, rng: np.random.Generator) -> None:
        """Put a share of the particles, in place, far about the mean pose of others that they were drawn `of`.

        They stand for the case, of the given probability, that the others are astray.
        """
        mean, covariance = of.mean_state()
        astray = np.arange(len(self)) % 10 < 10 * share
        noise = _root(covariance[:3, :3]) @ rng.standard_normal((3, int(astray.sum())))
        self.state[:3, astray] = mean[:3, None] + width * noise
        prior = np.where(astray, probability / share, (1.0 - probability) / (1.0 - share))
        self.log_weight = self.log_weight + np.log(prior)

    def become(self, many: Particles, chosen: NDArray[np.intp]) -> None:
        """Take the place of `chosen` (M,) of many particles, all of equal weight, in place."""
        self.select(chosen // (len(many) // len(self)))
        self.state = many.state[:, chosen]
        self.pending = None

    def restart(
        self, place: Array, heading: float | Array, position_std: float, heading_std: float, rng: np.random.Generator
    ) -> None:
        """Spread all particles anew about a place and a heading, or one (M,) for each, in place; the rest stays."""
        count = len(self)
        self.state[:2] = (place + position_std * rng.standard_normal((count, 2))).T
        self.state[2] = heading + heading_std * rng.standard_normal(count)
        self.log_weight = np.zeros(count)
        self.pending = None

    def select(self, index: NDArray[np.intp]) -> None:
        """Replace the particles by copies of those at `index` (M,), all of equal weight."""
        # several times faster than to index, and particles stay along memory
        for name in ("state", "means", "covariances", "gnss_bias", "calibration", "grip"):
            setattr(self, name, getattr(self, name).take(index, axis=-1))
        if self.pending is not None:
            self.pending = self.pending.take(index, axis=-1)
        self.log_weight = np.zeros(len(index))

    def collapse(self, slots: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return means (2, K) and covariances (3, K) of new features over all particles: the mixtures' moments."""
        weights, means = self.weights, self.means.take(slots, axis=1)
        mean = means @ weights
        x, y = means - mean[:, :, None]
        return mean, (self.covariances.take(slots, axis=1) + np.array([x * x, x * y, y * y])) @ weights


@lru_cache(maxsize=8)
def _even(count: int) -> Array:
    weights = np.full(count, 1.0 / count)
    weights.setflags(write=False)
    return weights


def _root(covariance: Array) -> Array:
    """Return a root (3, 3) of the covariance of a pose, which may be certain of some direction."""
    try:
        return np.asarray(np.linalg.cholesky(covariance + 1e-12 * np.eye(3)))
    except np.linalg.LinAlgError:  # a cloud that is wide and flat needs a ridge of its own size
        std = np.sqrt(np.maximum(covariance.diagonal(), 1e-30))
        correlation = covariance / np.outer(std, std) + 1e-9 * np.eye(3)
        return np.asarray(std[:, None] * np.linalg.cholesky(correlation))
