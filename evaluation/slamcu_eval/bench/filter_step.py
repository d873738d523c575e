"""The time of one filter step on a simulated motorway: a camera frame with all that came since the last one."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import DetectionFrame
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_eval.highway import simulate

LENGTH_M = 5_000.0  # a quarter of the paper's drive, with its density of signs
_SIGNS = {"normal": 14, "deleted": 2, "new": 10}
_WARM_UP = 50  # steps: first calls, imports and caches are not the filter's


def step_times(particles: int, seed: int) -> NDArray[np.float64]:
    """Return the times of the steps of one simulated drive, in ms."""
    world, (drive,) = simulate(seed, 1, world_length_m=LENGTH_M, **_SIGNS)
    car = SlamcuFilter(
        world.hd_map, drive.header, FilterParameters(particles=particles), rng=np.random.default_rng(seed)
    )
    times, step = [], 0.0
    for record in drive.records:
        begin = perf_counter()
        car.feed(record)
        step += perf_counter() - begin
        if isinstance(record, DetectionFrame):
            times.append(1e3 * step)
            step = 0.0
    return np.array(times[_WARM_UP:])


def bench_filter(particles: Sequence[int], seed: int) -> dict[str, Any]:
    """Return mean, median and 99th percentile of the step per number of particles, in ms."""
    result = {}
    for count in particles:
        times = step_times(count, seed)
        result[str(count)] = {
            "mean_ms": float(times.mean()),
            "p50_ms": float(np.percentile(times, 50)),
            "p99_ms": float(np.percentile(times, 99)),
            "steps": len(times),
        }
    return result
