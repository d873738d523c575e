"""Running an ablation: every variant over the same simulated drives, and if given over the same recorded robots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from slamcu_core.filter import FilterParameters
from slamcu_eval.ablation.parts import replaced
from slamcu_eval.ablation.variants import VARIANTS
from slamcu_eval.copies import run_all
from slamcu_eval.fleet import drive_vehicle
from slamcu_eval.highway import HighwayParameters
from slamcu_eval.mrclam.experiment import robot_run
from slamcu_eval.mrclam.robots import Setting, edits_of, job_of, robots_of
from slamcu_eval.paper import Run, run_filter
from slamcu_eval.score import Score

MOTORWAY, ROBOTS = "motorway", "robots"


@dataclass(frozen=True, slots=True)
class Cell:
    """What came of one drive with one variant."""

    variant: str
    world: str  # motorway or robots
    drive: str
    score: Score
    pose_rmse_m: float
    diverged: bool
    step_ms: float  # mean


@dataclass(frozen=True, slots=True)
class _HighwayTask:
    variant: str
    seed: int
    drive: int
    particles: int
    parameters: HighwayParameters | None

    def run(self) -> Cell:
        variant = VARIANTS[self.variant]
        run = _simulate(self.seed, self.drive, self.parameters)
        with replaced(variant.swaps):
            outcome = run_filter(run, variant.change(FilterParameters(particles=self.particles)))
        return Cell(
            self.variant,
            MOTORWAY,
            outcome.name,
            outcome.score,
            outcome.rmse_m,
            outcome.diverged,
            float(outcome.step_ms.mean()),
        )


@lru_cache(maxsize=2)
def _simulate(seed: int, drive: int, parameters: HighwayParameters | None) -> Run:
    return Run.simulate(seed, drive, parameters)


@dataclass(frozen=True, slots=True)
class _RobotTask:
    variant: str
    setting: Setting
    session: int
    edit: int
    robot: int

    def run(self) -> Cell:
        variant = VARIANTS[self.variant]
        (edit,) = [e for e in edits_of(self.setting) if (e.session, e.number) == (self.session, self.edit)]
        job = job_of(self.setting, edit, self.robot, edit.hd_map, None)
        job = replace(job, parameters=variant.change(job.parameters or FilterParameters.robot()))
        with replaced(variant.swaps):
            outcome = drive_vehicle(job)
        run = robot_run(edit, job, outcome)
        return Cell(self.variant, ROBOTS, run.name, run.score, run.pose_rmse_m, run.diverged, float(run.step_ms.mean()))


def run_ablation(
    variants: Sequence[str],
    *,
    drives: int,
    seed: int,
    particles: int = 100,
    robots: Setting | None = None,
    jobs: int = 1,
    parameters: HighwayParameters | None = None,
    begin: Callable[[int], None] = lambda _runs: None,
    done: Callable[[], None] = lambda: None,
) -> list[Cell]:
    """Run variants over the same drives and return all cells, in the order of drives and then of variants.

    Parameters
    ----------
    drives : simulated drives, each in a world of its own, the same as those of `slamcu-eval paper` with that seed.
    robots : recorded robots to be driven as well, each alone; None: no robots.
    begin : called with the number of runs to come; done : called after each.

    Raises SlamcuError if a variant replaces a part that the filter does not have.
    """
    tasks: list[_HighwayTask | _RobotTask] = [
        _HighwayTask(variant, seed, drive, particles, parameters) for drive in range(drives) for variant in variants
    ]
    if robots is not None:
        tasks += [
            _RobotTask(variant, robots, edit.session, edit.number, robot)
            for edit in edits_of(robots)
            for robot in robots_of(robots, edit.session)
            for variant in variants
            if VARIANTS[variant].on_robots
        ]
    begin(len(tasks))
    return run_all(min(jobs, len(tasks)) or 1, [task.run for task in tasks], done)
