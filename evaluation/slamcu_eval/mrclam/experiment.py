"""The experiment: every robot drives alone, and all robots of a session report to one server."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamcu_client.results import result_features
from slamcu_core.aggregation import ClassPolicy, Policy
from slamcu_core.formats import ResultFeature, write_hd_map
from slamcu_eval.commands.score import claims_from
from slamcu_eval.fleet import Account, Cloud, VehicleJob, VehicleOutcome, drive_fleet, fetch_map, fused_result
from slamcu_eval.mrclam.robots import Edit, Setting, edits_of, job_of, robots_of
from slamcu_eval.mrclam.runs import ARENA, LANDMARK_CLASS
from slamcu_eval.score import ROBOT_RADIUS_M, Score, score
from slamcu_eval.trust import Trust, judge, lost_at

DIVERGED_RMSE_M = 0.5  # robots (evaluation contract)

ARENA_POLICY = Policy(
    classes={
        LANDMARK_CLASS: ClassPolicy(
            trust=0.9,  # five robots of one laboratory, no strangers; at the road's 0.7 it takes four to delete
            strangers_more=0,  # nor do they need more company than the quorum, which is the road's
            # m; bias common to one robot's passes: it keeps what it has found where it found it, and its pose was off
            # by as much as robots' poses are at the median of their drives
            position_floor_m=0.1,
            position_common_m=0.02,  # m; the map's own error: the landmarks are surveyed
            match_radius_m=0.7,  # m; landmarks stand as near as 0.73 m to each other
            pair_radius_m=0.7,  # m; what stands further off is another landmark, not one that moved
        )
    }
)
"""The cloud's law for a few known robots in an arena of 10 m; all else, the quorum too, is as on the road."""


@dataclass(frozen=True, slots=True)
class RobotRun:
    """What came of one robot's run against one wrong map."""

    name: str
    session: int
    score: Score
    pose_rmse_m: float
    step_ms: NDArray[np.float64]
    trust: Trust

    @property
    def diverged(self) -> bool:
        """Whether the filter lost its way."""
        return not self.pose_rmse_m <= DIVERGED_RMSE_M


@dataclass(frozen=True, slots=True)
class FusedMap:
    """What the cloud made of one wrong map."""

    name: str
    session: int
    score: Score


def run_experiment(
    setting: Setting,
    *,
    jobs: int | None = None,
    begin: Callable[[Sequence[str]], None] = lambda _names: None,
    tell: Callable[[int, float], None] = lambda _run, _share: None,
) -> tuple[list[RobotRun], list[FusedMap]]:
    """Run every robot against every wrong map, and fuse what the robots of each map report.

    A robot keeps its credential over the edits and sessions: it is one contributor. All fetch their map before anyone
    drives, so that what one is told does not depend on how fast another was.

    Parameters
    ----------
    jobs : robots that drive at the same time; by default one per processor.
    begin : called once with the names of the runs.
    tell : called with the number of a run and the share of it that is done.

    Raises FormatError or MissingRecordingError if the recordings cannot be used, CloudError if the server fails.
    """
    edits = edits_of(setting)
    runs = [(edit, robot) for edit in edits for robot in robots_of(setting, edit.session)]
    with Cloud(policy=ARENA_POLICY) as cloud:
        _import_maps(cloud, edits)
        robots = sorted({robot for _, robot in runs})
        keys = dict(zip(robots, cloud.create_keys("vehicle", len(robots)), strict=True))
        plan: list[VehicleJob] = []
        for edit, robot in runs:
            account = Account(cloud.url, keys[robot], cloud.scratch / f"{edit.name}-robot-{robot}")
            plan.append(job_of(setting, edit, robot, fetch_map(account, edit.name), account))
        begin([str(job.drive) for job in plan])
        outcomes = drive_fleet(plan, processes=jobs, tell=tell)
        cloud.wait_until_fused()
        fused = [FusedMap(edit.name, edit.session, _score(edit, fused_result(cloud, edit.name))) for edit in edits]
    single = [robot_run(edit, job, outcome) for (edit, _), job, outcome in zip(runs, plan, outcomes, strict=True)]
    return single, fused


def robot_run(edit: Edit, job: VehicleJob, outcome: VehicleOutcome) -> RobotRun:
    """Return what came of one robot's drive against one wrong map, alone."""
    reports = [(one, message.health.trusted) for message in outcome.messages for one in message.passes]
    return RobotRun(
        name=str(job.drive),
        session=edit.session,
        score=_score(edit, list(result_features(outcome.features))),
        pose_rmse_m=outcome.pose_rmse_m,
        step_ms=outcome.step_ms,
        trust=Trust(
            told=judge(reports, edit.facts, ARENA.to_local, start=outcome.start_time, radius_m=ROBOT_RADIUS_M),
            diverged=not outcome.pose_rmse_m <= DIVERGED_RMSE_M,
            lost_at=lost_at(outcome.pose_t, outcome.pose_errors_m, DIVERGED_RMSE_M),
        ),
    )


def _score(edit: Edit, features: list[ResultFeature]) -> Score:
    return score(edit.facts, claims_from(features, ARENA), radius_m=ROBOT_RADIUS_M)


def _import_maps(cloud: Cloud, edits: Sequence[Edit]) -> None:
    for edit in edits:
        path = cloud.scratch / f"{edit.name}.geojson"
        path.write_text("".join(write_hd_map(edit.hd_map.identity, edit.hd_map)), encoding="utf-8")
        cloud.import_map(path)
