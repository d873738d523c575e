"""Signs that moved by a few metres: cars take them for the mapped ones, and yet each becomes one change."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from itertools import combinations, pairwise

import numpy as np
import pytest

from slamcu_eval.fleet import Account, Cloud, HighwayDrive, VehicleJob, drive_vehicle, fetch_map, standing_changes
from slamcu_eval.highway import HighwayParameters, make_world
from slamcu_eval.highway.files import write_world

SEED = 5  # of a world with unchanged signs between two that have moved, 64 m apart
WAVES = (0, 4, 10)  # of cars that set out with the same map
ROAD = HighwayParameters().having(
    length_m=1500.0, normal=24, deleted=0, new=2, moved=4, moved_min_m=3.0, moved_max_m=3.5, grouped_share=0.0
)


@pytest.mark.slow
def test_a_sign_that_moved_by_three_metres_is_one_moved_change_and_one_that_stays_is_none() -> None:
    world = make_world(SEED, ROAD.world)
    with Cloud() as cloud:
        write_world(world, cloud.scratch)
        cloud.import_map(cloud.scratch / "map.geojson")
        keys = cloud.create_keys("vehicle", WAVES[-1])
        departure = datetime.now(UTC) - timedelta(hours=WAVES[-1] + 1)
        for first, last in pairwise(WAVES):
            accounts = [Account(cloud.url, keys[n], cloud.scratch / f"vehicle-{n}") for n in range(first, last)]
            hd_map = fetch_map(accounts[0], world.name)
            for number, account in enumerate(accounts, start=first):
                drive = HighwayDrive(SEED, number, ROAD, departure + timedelta(hours=number))
                drive_vehicle(VehicleJob(drive, drive.filter_seed, hd_map, account))
            cloud.wait_until_fused()
        changes = [change for change in standing_changes(cloud, world.name) if change["state"] == "confirmed"]

    moved = {sign.map_object_id: sign for sign in world.signs if sign.truth == "moved"}
    assert len(moved) == 4
    assert min(np.hypot(*np.subtract(a.map_place, b.map_place)) for a, b in combinations(moved.values(), 2)) < 80.0
    about_the_map = [change for change in changes if change["map_object_id"] is not None]
    assert sorted(change["map_object_id"] for change in about_the_map) == sorted(moved)
    assert {change["kind"] for change in about_the_map} == {"moved"}
    for change in about_the_map:
        sign = moved[change["map_object_id"]]
        place = world.frame.to_local(*change["geometry"]["coordinates"])
        assert np.hypot(*(place - np.array(sign.place))) < np.hypot(*(place - np.array(sign.map_place)))
    # what else is told are the signs that the map lacks
    new = [change for change in changes if change["kind"] == "new"]
    assert len(new) == sum(sign.truth == "new" for sign in world.signs)
