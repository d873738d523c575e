"""The road of the story: its map, its truth, and the drives of two fleets, as files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from slamcu_eval.highway import World, make_drive, make_world
from slamcu_eval.highway.files import prepare_folder, write_drive, write_world
from slamcu_eval.paper import facts_of
from slamcu_eval.scenario.plan import Plan
from slamcu_eval.score import Fact

_AGO = timedelta(hours=3)
_GAP = timedelta(minutes=1)


@dataclass(frozen=True, slots=True)
class Stage:
    """A world as files, and the drives along it."""

    world: World
    facts: tuple[Fact, ...]
    map_file: Path
    logs: tuple[Path, ...]  # the first fleet's, then the second's
    longest_s: float  # of the drives

    @property
    def name(self) -> str:
        """The map's name."""
        return self.world.name


def set_stage(plan: Plan, folder: Path) -> Stage:
    """Simulate the world and the drives of both fleets into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    prepare_folder(folder)
    world = make_world(plan.seed, plan.road.world)
    write_world(world, folder)
    logs, longest = [], 0.0
    # Today: what was seen half a year ago would have faded by now.
    first = datetime.now(UTC).replace(microsecond=0) - _AGO
    for vehicle in range(plan.cars + plan.second_cars):
        drive = make_drive(world, plan.seed, vehicle, plan.road)
        started = first + vehicle * _GAP
        session = f"{world.name}-{vehicle:03d}-{started:%Y%m%dT%H%M%SZ}"
        write_drive(replace(drive, header=replace(drive.header, start_time=started, session_id=session)), folder)
        logs.append(folder / "drives" / f"{drive.header.vehicle_id}.jsonl.gz")
        longest = max(longest, drive.records[-1].t)
    return Stage(world, tuple(facts_of(world)), folder / "map.geojson", tuple(logs), longest)
