"""The places that a car reports of what its map has are corrected by what it has learned of its camera."""

from __future__ import annotations

import numpy as np

from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_eval.highway import HighwayParameters, make_drive, make_world


def _ahead(scale: float) -> float:
    """Return how far ahead of where they stand, in the median, a car with a wrong range scale reports signs."""
    parameters = HighwayParameters().having(
        length_m=5_000.0, normal=50, deleted=0, new=0, range_bias_std=0.0, common_range_bias=scale
    )
    world = make_world(5, parameters.world)
    drive = make_drive(world, 5, 0, parameters)
    car = SlamcuFilter(world.hd_map, drive.header, FilterParameters(), rng=np.random.default_rng(5))
    signs = {sign.map_object_id: sign for sign in world.signs}
    ahead = []
    passes = [report for record in drive.records for report in car.feed(record)] + car.finish()
    for report in passes[len(passes) // 2 :]:  # it has to learn first
        if report.reference is not None and report.position is not None:
            sign = signs[report.reference.object_id]
            shift = world.frame.to_local(report.position.lon, report.position.lat) - np.array(sign.place)
            ahead.append(-float(shift @ [np.cos(sign.heading), np.sin(sign.heading)]))  # its face looks back
    assert len(ahead) > 15
    return float(np.median(ahead))


def test_a_camera_whose_ranges_are_wrong_does_not_shift_what_it_saw() -> None:
    # uncorrected the two are 2 m apart
    assert abs(_ahead(0.05) - _ahead(-0.05)) < 0.8
