"""The time of a step in the dense field (`scene`), by number of particles, the cars taking turns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from statistics import median
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from slamcu_core.drive import DetectionFrame, Record
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_eval.bench.kernel import Kernel
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
        self.processor_ms: list[float] = []
        self.detections: list[int] = []
        self.mapped_in_view: list[int] = []
        self.live_finds: list[int] = []
        for step in islice(self._steps, round(SETTLE_S * RATE_HZ)):
            self._take(step)

    def go(self) -> float:
        """Do the steps of a round and return steps per second."""
        begin = len(self.times_ms)
        for step in islice(self._steps, _ROUND_STEPS):
            wall, processor = self._take(step)
            self.times_ms.append(1e3 * wall)
            self.processor_ms.append(1e3 * processor)
            self.detections.append(len(step[-1].items))  # type: ignore[union-attr]  # a step ends with its frame
            ahead = self.scene.mapped - [SPEED * step[-1].t, 0.0]
            self.mapped_in_view.append(int(in_view(ahead).sum()))
            self.live_finds.append(self._car.live_finds)
        return 1e3 / float(np.mean(self.times_ms[begin:]))

    def _take(self, step: list[Record]) -> tuple[float, float]:
        """Take a step and return what it took of the clock and of the processor, s."""
        wall, processor = perf_counter(), thread_time()
        for record in step:
            self._car.feed(record)
        return perf_counter() - wall, thread_time() - processor


def bench_scene(particles: Sequence[int], rounds: int, seed: int) -> dict[str, Any]:
    """Return the step's median over rounds of their means, its median and its 99th percentile (ms), and the scene.

    In turn with the steps, eq. 16-19 alone are done for a frame's detections, by arrays and by the peer in loops: what
    a step costs in units of these does not depend on who else is using the machine.
    """
    cars = {count: SceneCar(count, _ROUND_STEPS * (rounds + 2), seed) for count in particles}
    kernel = Kernel(particles[0], seed)
    ways: dict[str, Callable[[], float]] = {str(count): partial(SceneCar.go, car) for count, car in cars.items()}
    rates = interleave(ways | {"numpy": kernel.arrays, "peer": kernel.loops}, rounds)
    one = next(iter(cars.values()))
    own = rates[str(particles[0])].median
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
                "processor_mean": float(np.mean(car.processor_ms)),
                "processor_p99": float(np.percentile(car.processor_ms, 99)),
                "steps": len(car.times_ms),
            }
            for count, car in cars.items()
        },
        "kernel": {
            "ms": {name: 1e3 / rates[name].median for name in ("numpy", "peer")},
            "peer_over_numpy": rates["numpy"].median / rates["peer"].median,
            "step_over_numpy": rates["numpy"].median / own,
            "peer_over_step": own / rates["peer"].median,
            "particles": particles[0],
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
