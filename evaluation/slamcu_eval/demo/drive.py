"""The fleet's part of the demonstration: every car drives the same road at the same time and reports to one server."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from slamcu_client.results import result_features
from slamcu_core.formats import ResultFeature
from slamcu_eval.commands.score import claims_from
from slamcu_eval.fleet import (
    Account,
    Cloud,
    HighwayDrive,
    VehicleJob,
    VehicleOutcome,
    drive_fleet,
    fetch_map,
    fused_result,
)
from slamcu_eval.highway import HighwayParameters, World, make_world
from slamcu_eval.highway.files import write_world
from slamcu_eval.paper import facts_of
from slamcu_eval.score import HIGHWAY_RADIUS_M, Claim, Fact, Score, score


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


def road_of(length_km: float) -> HighwayParameters:
    """Return the paper's road, or a shorter one with its signs as dense."""
    paper = HighwayParameters()
    share = 1e3 * length_km / paper.world.length_m
    counts = {kind: max(1, round(share * getattr(paper.world, kind))) for kind in ("normal", "deleted", "new")}
    return paper.having(length_m=1e3 * length_km, **counts)


def prepare_fleet(
    cloud: Cloud, seed: int, parameters: HighwayParameters, vehicles: int, folder: Path
) -> tuple[World, list[VehicleJob]]:
    """Draw a world, import its map, make each car an account, and let each fetch its map.

    Parameters
    ----------
    folder : where map and truth are written to.
    """
    world = make_world(seed, parameters.world)
    write_world(world, folder)
    cloud.import_map(folder / "map.geojson")
    jobs = []
    for vehicle, key in enumerate(cloud.create_keys("vehicle", vehicles)):
        account = Account(cloud.url, key, cloud.scratch / f"vehicle-{vehicle:03d}")
        drive = HighwayDrive(seed, vehicle, parameters)
        jobs.append(VehicleJob(drive, drive.filter_seed, fetch_map(account, world.name), account))
    return world, jobs


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
