"""A stretch whose map is wrong: every car doubts itself there, and together they tell what has changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest

from slamcu_core.formats.results import ChangeState
from slamcu_eval.fleet import (
    Account,
    Cloud,
    HighwayDrive,
    OpenDrive,
    VehicleJob,
    drive_vehicle,
    fetch_map,
    standing_changes,
)
from slamcu_eval.highway import HighwayParameters, World, make_drive, make_world
from slamcu_eval.highway.files import write_world
from slamcu_eval.highway.signs import draw_other_sign

SEED = 2
CARS = 8
DUG_UP = 8  # signs that follow each other: every other one is gone, the others say something else
ROAD = HighwayParameters().having(
    length_m=2500.0, normal=40, deleted=0, new=6, moved=0, modified=0, grouped_share=0.0, map_error_std_m=0.1
)


def roadworks() -> World:
    """Return a road whose map is right but for one stretch, and wrong about every sign there."""
    world = make_world(SEED, ROAD.world)
    mapped = [number for number, sign in enumerate(world.signs) if sign.truth == "normal"]
    begin = len(mapped) // 2 - DUG_UP // 2
    signs, rng = list(world.signs), np.random.default_rng(SEED)
    for turn, number in enumerate(mapped[begin : begin + DUG_UP]):
        was = signs[number]
        if turn % 2 == 0:
            signs[number] = replace(was, truth=ChangeState.DELETED, place=None, sign=None, value=None)
        else:
            sign, value = draw_other_sign((str(was.sign), was.value), rng)
            signs[number] = replace(was, truth=ChangeState.MODIFIED, sign=sign, value=value)
    standing = np.array([number for number, sign in enumerate(signs) if sign.place is not None], np.intp)
    places = np.array([signs[number].place for number in standing], float)
    return replace(world, signs=tuple(signs), standing=standing, places=places)


@dataclass(frozen=True, slots=True)
class RoadworksDrive(HighwayDrive):
    """A drive along it."""

    def open(self) -> OpenDrive:
        drive = make_drive(roadworks(), self.seed, self.vehicle, self.parameters, departure=self.departure)
        truth = np.column_stack([drive.reference.t, drive.reference.lon, drive.reference.lat])
        return OpenDrive(drive.header, drive.records, truth)


@pytest.mark.slow
def test_what_all_cars_doubt_in_one_place_is_told() -> None:
    world = roadworks()
    with Cloud() as cloud:
        write_world(world, cloud.scratch)
        cloud.import_map(cloud.scratch / "map.geojson")
        keys = cloud.create_keys("vehicle", CARS)
        departure = datetime.now(UTC) - timedelta(hours=CARS + 1)
        hd_map = fetch_map(Account(cloud.url, keys[0], cloud.scratch / "vehicle-0"), world.name)
        messages = []
        for number, key in enumerate(keys):
            drive = RoadworksDrive(SEED, number, ROAD, departure + timedelta(hours=number))
            account = Account(cloud.url, key, cloud.scratch / f"vehicle-{number}")
            outcome = drive_vehicle(VehicleJob(drive, drive.filter_seed, hd_map, account))
            messages += outcome.messages
        cloud.wait_until_fused()
        changes = [change for change in standing_changes(cloud, world.name) if change["state"] == "confirmed"]
        evidence = {
            change["map_object_id"]: _of_the_old_half(cloud.get(f"/v1/changes/{change['id']}"))
            for change in changes
            if change["map_object_id"] is not None
        }

    truth = {sign.map_object_id: sign.truth.value for sign in world.signs if sign.truth in {"deleted", "modified"}}
    gone = set(truth)
    denied = {False: dict.fromkeys(gone, 0), True: dict.fromkeys(gone, 0)}
    for message in messages:
        for report in message.passes:
            if report.reference is not None and report.reference.object_id in gone:
                denied[message.health.trusted][report.reference.object_id] += report.weight_against > 1.0
    unaided = [key for key in gone if denied[True][key] < 4]
    assert len(unaided) >= 3, "fewer than it takes were sure of themselves there"
    assert {change["map_object_id"]: change["kind"] for change in changes if change["kind"] != "new"} == truth
    for key in unaided:
        assert sum(part["in_doubt"] and part["folds"] for part in evidence[key]["contributions"]) >= 4
    new = [change for change in changes if change["kind"] == "new"]
    assert len(new) == sum(sign.truth == "new" for sign in world.signs)
    assert len(changes) == len(gone) + len(new)


def _of_the_old_half(change: dict[str, Any]) -> dict[str, Any]:
    """Return the evidence about what the map has."""
    evidence: dict[str, Any] = change["evidence_from"] or change["evidence"]
    return evidence
