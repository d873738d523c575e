"""Equations 16-19 alone, by the filter's arrays and by its peer in loops, in turn on the same inputs."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from slamcu_core.models import SensorModel
from slamcu_eval.bench.peer import StepInput, numpy_step, peer_step
from slamcu_eval.bench.rounds import interleave
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


def bench_kernel(particles: int, rounds: int, seed: int) -> dict[str, Any]:
    """Return the time of eq. 16-19 by arrays and by the peer, in ms, and how much longer the peer takes."""
    step, model = step_input(particles, _KNOWN, _NEW, np.random.default_rng(seed)), SensorModel(CAMERA)

    def arrays() -> float:
        begin = perf_counter()
        for _ in range(_REPEATS):
            numpy_step(model, step)
        return _REPEATS / (perf_counter() - begin)

    def loops() -> float:
        begin = perf_counter()
        peer_step(step)
        return 1.0 / (perf_counter() - begin)

    rates = interleave({"numpy": arrays, "peer": loops}, rounds)
    times = {name: 1e3 / rate.median for name, rate in rates.items()}
    return {"ms": times, "peer_over_numpy": times["peer"] / times["numpy"], "particles": particles, "rounds": rounds}
