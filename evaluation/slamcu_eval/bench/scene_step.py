"""The time of a step in the dense field (`scene`), by number of particles, the cars taking turns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from slamcu_core.drive import DetectionFrame, Record
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_eval.bench.rounds import interleave
from slamcu_eval.bench.scene import HEADER, RATE_HZ, SETTLE_S, SPEED, Scene, in_view

_ROUND_STEPS = 30  # two seconds of driving


class SceneCar:
    """A car that has driven far enough into the field for the number of its live finds to have settled."""

    def __init__(self, particles: int, steps: int, seed: int) -> None:
        seconds = SETTLE_S + steps / RATE_HZ
        rng = np.random.default_rng(seed)
        self.scene = Scene.make(seconds, rng)
        self._steps = _by_step(self.scene.records(seconds, rng))
        self._car = SlamcuFilter(
            self.scene.hd_map(), HEADER, FilterParameters(particles=particles), rng=np.random.default_rng(seed + 1)
        )
        self.times_ms: list[float] = []
        self.detections: list[int] = []
        self.mapped_in_view: list[int] = []
        self.live_finds: list[int] = []
        for step in islice(self._steps, round(SETTLE_S * RATE_HZ)):
            self._take(step)

    def go(self) -> float:
        """Do the steps of a round and return steps per second."""
        begin = len(self.times_ms)
        for step in islice(self._steps, _ROUND_STEPS):
            self.times_ms.append(1e3 * self._take(step))
            self.detections.append(len(step[-1].items))  # type: ignore[union-attr]  # a step ends with its frame
            ahead = self.scene.mapped - [SPEED * step[-1].t, 0.0]
            self.mapped_in_view.append(int(in_view(ahead).sum()))
            self.live_finds.append(self._car.live_finds)
        return 1e3 / float(np.mean(self.times_ms[begin:]))

    def _take(self, step: list[Record]) -> float:
        begin = perf_counter()
        for record in step:
            self._car.feed(record)
        return perf_counter() - begin


def bench_scene(particles: Sequence[int], rounds: int, seed: int) -> dict[str, Any]:
    """Return the step's median over rounds of their means, its median and its 99th percentile (ms), and the scene."""
    cars = {count: SceneCar(count, _ROUND_STEPS * (rounds + 2), seed) for count in particles}
    ways: dict[str, Callable[[], float]] = {str(count): partial(SceneCar.go, car) for count, car in cars.items()}
    rates = interleave(ways, rounds)
    one = next(iter(cars.values()))
    return {
        "scene": {
            "detections": float(np.mean(one.detections)),
            "map_features_in_view": float(np.mean(one.mapped_in_view)),
            "live_finds": float(np.mean(one.live_finds)),
        },
        "step_ms": {
            str(count): {
                "mean": median(1e3 / rate for rate in rates[str(count)].per_round),
                "p50": float(np.percentile(car.times_ms, 50)),
                "p99": float(np.percentile(car.times_ms, 99)),
                "steps": len(car.times_ms),
            }
            for count, car in cars.items()
        },
        "rounds": rounds,
    }


def _by_step(records: Iterator[Record]) -> Iterator[list[Record]]:
    """Yield the records of each step: a frame with all that came since the last one."""
    step: list[Record] = []
    for record in records:
        step.append(record)
        if isinstance(record, DetectionFrame):
            yield step
            step = []
