"""What a step costs against the size of the map and the length of the drive, and the memory of a long session.

All three should be flat. Cars with maps of different sizes, and one car as it was after different lengths (copies made
on the way), drive the same next seconds at the camera's full rate, in turn.
"""

from __future__ import annotations

import copy
import gc
import tracemalloc
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from slamcu_core.drive import DetectionFrame
from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.hd_map import HDMap
from slamcu_eval.bench.long_road import FAST_RATE_HZ, FULL_RATE_HZ, HEADER, SPACING_M, SPEED, LongDrive, hd_map
from slamcu_eval.bench.rounds import interleave

_ROUND_S = 4.0  # s of driving in a round
_WARM_UP_S = 60.0


class Ride:
    """A car on the long road, with the drive that it is fed by."""

    def __init__(self, road: HDMap, particles: int) -> None:
        self.road = road
        self.car = SlamcuFilter(road, HEADER, FilterParameters(particles=particles), rng=np.random.default_rng(2))
        self.drive = LongDrive()

    def go(self, seconds: float, rate_hz: float) -> float:
        """Drive on and return steps per second of the processor, whoever else was using it."""
        records = list(self.drive.records(seconds, rate_hz))
        begin = thread_time()
        for record in records:
            self.car.feed(record)
        return sum(isinstance(record, DetectionFrame) for record in records) / (thread_time() - begin)

    def to(self, driven_m: float) -> None:
        """Drive on, fast-forwarded, until so many metres from the start."""
        while self.drive.driven < driven_m:
            self.go(min(100.0, (driven_m - self.drive.driven) / SPEED + 1.0 / FAST_RATE_HZ), FAST_RATE_HZ)

    def copied(self) -> Ride:
        """Return a copy that shares the map."""
        return copy.deepcopy(self, {id(self.road): self.road})


def map_curve(sizes: Sequence[int], rounds: int, particles: int = 100) -> dict[str, Any]:
    """Return the median step (ms) per size of the map, and what its index took to build (s) and holds (MB)."""
    length = SPEED * (_WARM_UP_S + _ROUND_S * (rounds + 2))
    rides, building = {}, {}
    for size in sizes:
        gc.collect()
        memory, begin = resident_mb(), perf_counter()
        road = hd_map(length, max(0, size - round(length / SPACING_M * 2.0 / 3.0)))
        building[str(size)] = {"build_s": perf_counter() - begin, "memory_mb": resident_mb() - memory}
        rides[str(size)] = Ride(road, particles)
        rides[str(size)].to(SPEED * _WARM_UP_S)
    return {"step_ms": _step_ms(rides, rounds), "map": building}


def drive_curve(lengths_km: Sequence[float], rounds: int, particles: int = 100) -> dict[str, Any]:
    """Return the median step (ms) per length driven (km), and the rows in the filter's table then."""
    ride = Ride(hd_map(1e3 * max(lengths_km) + SPEED * _ROUND_S * (rounds + 2)), particles)
    rides = {}
    for length in sorted(lengths_km):
        ride.to(1e3 * length)
        rides[f"{length:g}"] = ride.copied()
    rows = {name: at.car.live_rows for name, at in rides.items()}
    return {"step_ms": _step_ms(rides, rounds), "rows": rows}


def memory_curve(hours: float, samples: int = 12, particles: int = 100) -> dict[str, Any]:
    """Return what the filter has allocated (MB), the map apart, over the hours of one session, fast-forwarded."""
    road = hd_map(3600.0 * hours * SPEED)
    at, memory = [], []
    tracemalloc.start()
    try:
        ride = Ride(road, particles)
        for sample in range(samples + 1):
            ride.to(3600.0 * hours * SPEED * sample / samples)
            gc.collect()
            at.append(hours * sample / samples)
            memory.append(tracemalloc.get_traced_memory()[0] / 1e6)
    finally:
        tracemalloc.stop()
    return {"hours": at, "memory_mb": memory, "frames_per_s": FAST_RATE_HZ, "map_features": len(road)}


def resident_mb() -> float:
    """Return the memory of this process (MB), or NaN where the system does not say."""
    status = Path("/proc/self/status")
    if not status.exists():
        return float("nan")
    line = next(line for line in status.read_text(encoding="ascii").splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024.0


def _step_ms(rides: dict[str, Ride], rounds: int) -> dict[str, float]:
    ways: dict[str, Callable[[], float]] = {
        name: partial(ride.go, _ROUND_S, FULL_RATE_HZ) for name, ride in rides.items()
    }
    return {name: 1e3 / rate.median for name, rate in interleave(ways, rounds).items()}
