"""One road: cars drive it in waves, each with the map and the watch features that the ones before have brought about.

The waves end at the sizes that are asked for, so that the same drives serve all of them: the first V cars are the
fleet of size V. A car sets out an hour after the one before.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

from slamcu_client.results import result_features
from slamcu_core.formats.results import ChangeState
from slamcu_core.hd_map import HDMap
from slamcu_eval.commands.score import claims_from
from slamcu_eval.fleet import (
    Account,
    Cloud,
    HighwayDrive,
    VehicleJob,
    VehicleOutcome,
    drive_fleet,
    drive_vehicle,
    fetch_map,
)
from slamcu_eval.highway import HighwayParameters, World, make_drive, make_world
from slamcu_eval.highway.files import write_world
from slamcu_eval.many.reading import Reading, read_cloud
from slamcu_eval.many.recording import Recording
from slamcu_eval.many.roads import LENGTH_M, road_parameters, road_seed
from slamcu_eval.oracle import oracle_places

_FUSE_TIMEOUT_S = 600.0
_HOURS = 25  # before now that the first car sets out, at least: more cars may follow those of a run before
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be done on each road."""

    sizes: tuple[int, ...]  # of the fleet, rising
    seed: int
    common_bias: bool
    folder: Path  # recordings and readings, from which a run that was stopped goes on
    processes: int = 1  # cars that drive at the same time
    length_m: float = LENGTH_M

    @property
    def parameters(self) -> HighwayParameters:
        """The parameters of the roads."""
        return road_parameters(common_bias=self.common_bias, length_m=self.length_m)


@dataclass(frozen=True, slots=True)
class RoadResult:
    """What was said of one road."""

    world: World
    readings: tuple[Reading, ...]
    cars: tuple[Recording, ...]


def run_road(plan: Plan, road: int, say: Say = lambda _: None) -> RoadResult:
    """Let the fleet drive one road and read the cloud at each size; cars that are recorded do not drive again."""
    seed = road_seed(plan.seed, road)
    world = make_world(seed, plan.parameters.world)
    place = plan.folder / f"road-{road:02d}"
    place.mkdir(parents=True, exist_ok=True)
    done = place / f"readings-{'-'.join(map(str, plan.sizes))}.json"
    if done.exists():
        kept = [Reading.from_document(one) for one in json.loads(done.read_text(encoding="utf-8"))]
        return RoadResult(world, tuple(kept), tuple(_recorded(place, range(plan.sizes[-1]))))
    readings, cars = _drive(plan, world, seed, place, say)
    _write(done, [one.to_document() for one in readings])
    return RoadResult(world, tuple(readings), tuple(cars))


def _drive(plan: Plan, world: World, seed: int, place: Path, say: Say) -> tuple[list[Reading], list[Recording]]:
    readings, cars = list[Reading](), list[Recording]()
    departure = datetime.now(UTC).replace(minute=0, second=0, microsecond=0) - timedelta(
        hours=max(plan.sizes[-1], _HOURS)
    )
    with Cloud() as cloud:
        write_world(world, cloud.scratch)
        cloud.import_map(cloud.scratch / "map.geojson")
        keys = cloud.create_keys("vehicle", plan.sizes[-1])
        for first, last in pairwise((0, *plan.sizes)):
            hd_map: HDMap | None = None
            jobs: dict[int, VehicleJob] = {}
            for number in range(first, last):
                account = Account(cloud.url, keys[number], cloud.scratch / f"vehicle-{number:03d}")
                hd_map = hd_map or fetch_map(account, world.name)
                recorded = Recording.read(place / f"car-{number:02d}")
                if recorded is None:
                    drive = HighwayDrive(seed, number, plan.parameters, departure + timedelta(hours=number))
                    jobs[number] = VehicleJob(drive, drive.filter_seed, hd_map, account)
                else:
                    recorded.tell(account, [feature for feature in hd_map if feature.watched])
            say(f"cars {first + 1} to {last}: {len(jobs)} to drive")
            for number, outcome in _outcomes(jobs, plan.processes):
                kept = _recording(plan, world, HighwayDrive(seed, number, plan.parameters), jobs[number], outcome)
                kept.write(place / f"car-{number:02d}")
            cars += _recorded(place, range(first, last))
            cloud.wait_until_fused(_FUSE_TIMEOUT_S)
            readings.append(read_cloud(cloud, world.name, world.frame, last, minimum=last > 1))
    return readings, cars


def _recorded(place: Path, numbers: Iterable[int]) -> list[Recording]:
    cars = [Recording.read(place / f"car-{number:02d}") for number in numbers]
    return [car for car in cars if car is not None]


def _outcomes(jobs: Mapping[int, VehicleJob], processes: int) -> Iterator[tuple[int, VehicleOutcome]]:
    """Drive, several at a time in processes of their own, or one by one in this one."""
    if processes > 1 and len(jobs) > 1:
        yield from zip(jobs, drive_fleet(list(jobs.values()), processes=processes), strict=True)
    else:
        for number, job in jobs.items():
            yield number, drive_vehicle(job)


def _recording(plan: Plan, world: World, drive: HighwayDrive, job: VehicleJob, outcome: VehicleOutcome) -> Recording:
    """Return what is kept of a drive."""
    again = make_drive(world, drive.seed, drive.vehicle, plan.parameters)
    oracle = oracle_places(world, again, ChangeState.NEW)
    return Recording(
        messages=outcome.messages,
        watched=tuple(feature for feature in job.hd_map if feature.watched),
        claims=tuple(claims_from(list(result_features(outcome.features)), world.frame)),
        oracle={index: (float(xy[0]), float(xy[1])) for index, xy in oracle.items()},
        pose_rmse_m=outcome.pose_rmse_m,
    )


def _write(path: Path, document: Any) -> None:
    part = path.with_suffix(".part")
    part.write_text(json.dumps(document), encoding="utf-8")
    part.replace(path)
