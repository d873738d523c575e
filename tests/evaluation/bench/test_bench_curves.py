"""What a step touches and what the filter keeps do not grow with the map or the drive: counted, not timed."""

from __future__ import annotations

import numpy as np

from slamcu_core.filter import FilterParameters, SlamcuFilter
from slamcu_eval.bench.curves import Ride
from slamcu_eval.bench.long_road import FAST_RATE_HZ, HEADER, LongDrive, hd_map


def test_the_rows_at_work_do_not_grow_with_the_drive() -> None:
    ride = Ride(hd_map(60_000.0), particles=10)
    rows = []
    for kilometres in (5.0, 20.0, 55.0):  # beyond 15 km the local frame moves along
        ride.to(1e3 * kilometres)
        rows.append(ride.car.live_rows)
    assert max(rows) < 40
    assert len(ride.car._table) < 60, "rows are used again"
    finds = [feature for feature in ride.car.features() if feature.feature is None]
    assert len(finds) > 100, "the finds left behind are still known"


def test_the_rows_at_work_do_not_grow_with_the_map() -> None:
    rows = []
    for elsewhere in (0, 50_000):
        ride = Ride(hd_map(3_000.0, elsewhere), particles=10)
        ride.to(2_500.0)
        rows.append((ride.car.live_rows, len(ride.car._table)))
    assert rows[0] == rows[1] > (0, 0)


def test_what_is_kept_of_finds_is_bounded_and_the_latest_stay() -> None:
    drive = LongDrive()
    car = SlamcuFilter(hd_map(0.0), HEADER, FilterParameters(particles=10, kept_finds=20), rng=np.random.default_rng(0))
    for record in drive.records(400.0, FAST_RATE_HZ):
        car.feed(record)
    finds = [feature for feature in car.features() if feature.feature is None]
    behind = [feature for feature in finds if feature.lon < car.pose.lon - 0.01]
    assert car.live_rows < 60, "those of the last kilometres, which still follow"
    assert 20 <= len(finds) <= 20 + car.live_rows
    assert behind, "the archive has some"
    assert min(feature.lon for feature in behind) > HEADER.initial_pose.lon + 0.05, "the first ones gave way"
