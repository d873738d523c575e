"""The places that a car reports of what it was told of are corrected by what it learns of its camera and its way."""

from __future__ import annotations

import numpy as np

from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_core.filter.table import Kind
from slamcu_core.formats import ChangeState
from slamcu_core.hd_map import HDMap, MapFeature
from slamcu_eval.highway import HighwayParameters, make_drive, make_world


def _ahead(scale: float) -> float:
    """Return how far ahead of where they stand, in the median, a car with a wrong range scale reports signs."""
    parameters = HighwayParameters().having(
        length_m=3_500.0, normal=40, deleted=0, new=0, range_bias_std=0.0, common_range_bias=scale
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
    assert len(ahead) > 10
    return float(np.median(ahead))


def test_a_camera_whose_ranges_are_wrong_does_not_shift_what_it_saw() -> None:
    # uncorrected the two are 2 m apart
    assert abs(_ahead(0.05) - _ahead(-0.05)) < 0.8


def test_what_corrects_the_pose_corrects_the_place_of_a_watched_sign() -> None:
    # a sign that has moved a little misleads the pose; the signs behind it tell what was right
    parameters = HighwayParameters().having(length_m=3_500.0, normal=40, deleted=4, new=18, moved=4, moved_min_m=3.0)
    world = make_world(1, parameters.world)
    drive = make_drive(world, 1, 0, parameters)
    places = [np.array(sign.place) for sign in world.signs if sign.truth is ChangeState.NEW]
    watched = []
    for number, sign in enumerate(sign for sign in world.signs if sign.truth is ChangeState.NEW):
        lon, lat = map(float, world.frame.to_geographic(places[number] + np.array([0.6, -0.4])))
        watched.append(MapFeature(number + 1, lon, lat, sign=sign.sign, value=sign.value, tile_id=-1))
    hd_map = HDMap([*world.hd_map, *watched], world.hd_map.identity)
    car = SlamcuFilter(hd_map, drive.header, FilterParameters(), rng=np.random.default_rng(1))
    passes = [report for record in drive.records for report in car.feed(record)] + car.finish()
    off, squares = [], []
    for report in passes:
        if report.reference is not None and report.reference.watched and report.position is not None:
            found = world.frame.to_local(report.position.lon, report.position.lat)
            error = found - places[report.reference.object_id - 1]
            xx, xy, yy = report.position.covariance_m2
            off.append(float(np.hypot(*error)))
            squares.append(float(error @ np.linalg.solve(np.array([[xx, xy], [xy, yy]]), error)))
    assert len(off) >= 12
    assert np.mean(off) < 1.0  # single sightings: 2.4 m
    assert np.mean(np.array(squares) < 5.991) >= 0.9
    assert (car._table.slot[car._table.kind == Kind.WATCH] < 0).all()
