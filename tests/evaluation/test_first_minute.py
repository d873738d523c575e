"""The first minute of a drive: the start, the satellites and odometry must not make the filter surer than it may be."""

from __future__ import annotations

import numpy as np

from slamcu_core.drive import DetectionFrame
from slamcu_core.filter import SlamcuFilter
from slamcu_eval.highway import HighwayParameters
from slamcu_eval.paper import Run

# no signs of the map near: nothing corrects what the start has wrong
ROAD = HighwayParameters().having(length_m=1_500.0, normal=1, deleted=1, new=1, ghosts_per_s=0.0)


def _squares(seed: int) -> list[float]:
    """Drive 40 s and return the squared errors of the place in its own covariance (chi-square, 2 degrees)."""
    run = Run.simulate(seed, 0, ROAD)
    log, frame = run.drive, run.world.frame
    truth = frame.to_local(log.reference.lon, log.reference.lat)
    car = SlamcuFilter(run.world.hd_map, log.header, rng=np.random.default_rng(seed))
    squares: list[float] = []
    frames = 0
    for record in log.records:
        if record.t > 40.0:
            break
        car.feed(record)
        if isinstance(record, DetectionFrame):
            frames += 1
            if record.t > 8.0 and frames % 30 == 0:
                pose = car.pose
                true = [np.interp(record.t, log.reference.t, truth[:, axis]) for axis in (0, 1)]
                error = frame.to_local(pose.lon, pose.lat) - np.array(true)
                xx, xy, yy = pose.covariance_m2
                squares.append(float(error @ np.linalg.solve(np.array([[xx, xy], [xy, yy]]), error)))
    return squares


def test_the_filter_knows_how_little_it_knows_before_the_first_signs() -> None:
    drives = [np.mean(_squares(seed)) for seed in range(12)]
    # 2 is honest; copies that leave behind what hangs on their paths, and a start that counts twice, give 6
    assert 0.8 < np.mean(drives) < 3.5
    assert np.median(drives) < 3.0
