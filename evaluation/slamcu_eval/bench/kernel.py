"""Equations 16-19 alone, by the filter's arrays and by its peer in loops, on the same inputs."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from slamcu_core.models import SensorModel
from slamcu_eval.bench.peer import StepInput, numpy_step, peer_step
from slamcu_eval.bench.scene import CAMERA

_KNOWN, _NEW = 8, 2  # of the 10 detections of the scene's frame
_REPEATS = 50  # of the faster way in a round


def step_input(particles: int, known: int, new: int, rng: np.random.Generator) -> StepInput:
    """Make a frame of features ahead of a cloud of particles, each with its own map of the new ones."""
    model = SensorModel(CAMERA)
    heading = 3.1  # near the wrap of the angle
    pose = np.array([[0.0], [0.0], [heading]]) + np.array([[0.3], [0.3], [0.005]]) * rng.standard_normal((3, particles))
    distance, bearing = rng.uniform(5.0, 80.0, known + new), rng.uniform(-0.3, 0.3, known + new)
    true_pose = np.array([[0.0], [0.0], [heading]])
    places = model.invert(true_pose, np.array([distance, bearing]))
    noise = model.noise(np.array([distance, bearing]))
    measured = np.array([distance, bearing]) + np.sqrt(noise) * rng.standard_normal((2, known + new))
    root = rng.normal(0.0, 0.5, (2, 2, new, particles))
    spread = np.einsum("ijfk,ljfk->ilfk", root, root) + 0.05 * np.eye(2)[:, :, None, None]
    spread = np.array([spread[0, 0], spread[0, 1], spread[1, 1]])
    return StepInput(
        pose=pose,
        log_weight=np.log(rng.uniform(0.2, 1.0, particles)),
        map_place=places[:, :known],
        map_covariance=np.repeat(0.15**2 * np.array([[1.0], [0.0], [1.0]]), known, axis=1),
        map_measured=measured[:, :known],
        means=places[:, known:, None] + 0.3 * rng.standard_normal((2, new, particles)),
        covariances=spread,
        new_measured=measured[:, known:],
        map_noise=noise[:, :known],
        new_noise=noise[:, known:],
        log_clutter=model.log_clutter,
        outlier_share=0.02,
        temper=0.22,
    )


class Kernel:
    """Equations 16-19 for the detections of one frame; either way returns how often a second it can be done."""

    def __init__(self, particles: int, seed: int) -> None:
        self._step = step_input(particles, _KNOWN, _NEW, np.random.default_rng(seed))
        self._model = SensorModel(CAMERA)

    def arrays(self) -> float:
        """Do them by the filter's own operations on arrays."""
        begin = perf_counter()
        for _ in range(_REPEATS):
            numpy_step(self._model, self._step)
        return _REPEATS / (perf_counter() - begin)

    def loops(self) -> float:
        """Do them by the peer, one particle after the other."""
        begin = perf_counter()
        peer_step(self._step)
        return 1.0 / (perf_counter() - begin)
