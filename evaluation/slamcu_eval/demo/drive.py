"""The fleet's part of the demonstration: every car drives the same road at the same time and reports to one server."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from slamcu_client.results import result_features

from slamcu_core.formats import ResultFeature
from slamcu_eval.commands.score import claims_from
from slamcu_eval.fleet import (
    Account,
    Cloud,
    OpenDrive,
    VehicleJob,
    VehicleOutcome,
    drive_fleet,
    fetch_map,
    fused_result,
)
from slamcu_eval.highway import World, make_drive, make_world
from slamcu_eval.highway.files import write_world
from slamcu_eval.paper import facts_of
from slamcu_eval.score import HIGHWAY_RADIUS_M, Claim, Fact, Score, score


@dataclass(frozen=True, slots=True)
class HighwayDrive:
    """A drive along a simulated motorway, simulated in the process that drives it."""

    seed: int
    vehicle: int

    def open(self) -> OpenDrive:
        """Simulate the drive."""
        drive = make_drive(make_world(self.seed), self.seed, self.vehicle)
        truth = np.column_stack([drive.reference.t, drive.reference.lon, drive.reference.lat])
        return OpenDrive(drive.header, drive.records, truth)

    def __str__(self) -> str:
        return f"car {self.vehicle + 1}"


@dataclass(frozen=True, slots=True)
class Told:
    """What one teller, a car or the cloud, says of the road, and how that compares with the truth."""

    claims: tuple[Claim, ...]
    score: Score


@dataclass(frozen=True, slots=True)
class FleetResult:
    """What came of the fleet's drive."""

    world: World
    facts: tuple[Fact, ...]
    cars: tuple[Told, ...]
    outcomes: tuple[VehicleOutcome, ...]
    fused: Told
    result: tuple[ResultFeature, ...]  # of the cloud

    @property
    def messages(self) -> int:
        """How many messages the server acknowledged."""
        return sum(o.upload.accepted + o.upload.duplicates for o in self.outcomes if o.upload is not None)

    @property
    def passes(self) -> int:
        """How many passes the cars reported."""
        return sum(o.passes for o in self.outcomes)


def prepare_fleet(cloud: Cloud, world: World, seed: int, vehicles: int, folder: Path) -> list[VehicleJob]:
    """Import the world's map, make each car an account, and let each fetch its map."""
    write_world(world, folder)
    cloud.import_map(folder / "map.geojson")
    jobs = []
    for vehicle, key in enumerate(cloud.create_keys("vehicle", vehicles)):
        account = Account(cloud.url, key, cloud.scratch / f"vehicle-{vehicle:03d}")
        filter_seed = int(np.random.SeedSequence([seed, 2, vehicle]).generate_state(1)[0])
        jobs.append(VehicleJob(HighwayDrive(seed, vehicle), filter_seed, fetch_map(account, world.name), account))
    return jobs


def run_fleet(cloud: Cloud, world: World, jobs: list[VehicleJob], tell: Callable[[int, float], None]) -> FleetResult:
    """Let all cars drive at the same time, wait until the cloud has fused their reports, and score both."""
    outcomes = drive_fleet(jobs, processes=len(jobs), tell=tell)
    cloud.wait_until_fused()
    result = fused_result(cloud, world.name)
    facts = tuple(facts_of(world))
    return FleetResult(
        world=world,
        facts=facts,
        cars=tuple(_told(world, facts, list(result_features(outcome.features))) for outcome in outcomes),
        outcomes=tuple(outcomes),
        fused=_told(world, facts, result),
        result=tuple(result),
    )


def _told(world: World, facts: tuple[Fact, ...], result: list[ResultFeature]) -> Told:
    claims = claims_from(result, world.frame)
    return Told(tuple(claims), score(facts, claims, radius_m=HIGHWAY_RADIUS_M))
