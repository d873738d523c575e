"""The paper's experiment, simulated: one car, the real filter, and every figure of the evaluation contract.

Each drive has a world of its own, so that neither signs nor biases are shared and intervals by drive mean something.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import DetectionFrame
from slamcu_core.filter import FeatureEstimate, FilterParameters, SlamcuFilter
from slamcu_core.reports import PassReport
from slamcu_eval.copies import run_all
from slamcu_eval.curves import feature_curves
from slamcu_eval.highway import Drive, HighwayParameters, World, make_drive, make_world
from slamcu_eval.machine import machine
from slamcu_eval.oracle import oracle_errors, single_sighting_errors
from slamcu_eval.records import FeatureRecord, feature_records
from slamcu_eval.score import HIGHWAY_RADIUS_M, Claim, Fact, Score, figures, score
from slamcu_eval.statistics import cluster_interval, summarize
from slamcu_eval.trust import Trust, judge, lost_at, trust_figures

DIVERGED_RMSE_M = 3.0  # motorway (evaluation contract)
_POSE_EVERY = 15  # frames between two looks at the pose

PUBLISHED: dict[str, Any] = {
    "accuracy": 0.9612,
    "accuracy_ci95": (0.904, 0.985),
    "features": 103,
    "drives": 1,
    "new_position_error_m": {"mean": 0.8, "std": 0.9},
    "step_ms": {"mean": 30.39},
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one drive."""

    name: str
    score: Score
    pose_errors_m: tuple[float, ...]
    oracle_errors_m: tuple[float, ...]  # of the new signs that the filter found
    oracle_errors_all_m: tuple[float, ...]  # of every new sign that was detected at all
    single_sighting_m: tuple[float, ...]
    step_ms: NDArray[np.float64]
    trust: Trust
    records: tuple[FeatureRecord, ...]

    @property
    def rmse_m(self) -> float:
        """Root mean square of the horizontal pose error over the drive."""
        return _rmse(self.pose_errors_m)

    @property
    def diverged(self) -> bool:
        """Whether the filter lost its way on this drive."""
        return not self.rmse_m <= DIVERGED_RMSE_M


def _rmse(errors: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def world_seed(seed: int, drive: int) -> int:
    """Return the seed of the world of a drive: `slamcu-eval simulate highway --seed` with it draws the same."""
    return int(np.random.SeedSequence([seed, drive]).generate_state(1)[0])


def facts_of(world: World, drive: Drive | None = None) -> list[Fact]:
    """Return what is true of a world, and of each feature whether a drive ever had it in view."""
    facts = []
    for index, sign in enumerate(world.signs):
        place = sign.place or sign.map_place or (float("nan"), float("nan"))
        seen = bool(drive.in_view[index]) if drive is not None else None
        facts.append(Fact(sign.truth.value, place, sign.map_object_id, sign.sign, sign.value, seen))
    return facts


def claims_of(world: World, features: Sequence[FeatureEstimate]) -> list[Claim]:
    """Return what a filter claims, in the frame of a world."""
    if not features:
        return []
    places = world.frame.to_local([f.lon for f in features], [f.lat for f in features])
    return [
        Claim(
            state=f.state,
            place=(float(place[0]), float(place[1])),
            covariance=f.covariance_m2,
            object_id=f.feature.object_id if f.feature is not None else None,
            sign=f.sign,
            value=f.value,
            passes=f.passes,
        )
        for f, place in zip(features, places, strict=True)
        if f.feature is None or not f.feature.watched
    ]


@dataclass(frozen=True, slots=True)
class Run:
    """A simulated drive, ready for a filter."""

    number: int
    seed: int  # of its world
    world: World
    drive: Drive

    @classmethod
    def simulate(cls, seed: int, number: int, parameters: HighwayParameters | None = None) -> Run:
        """Simulate drive `number` of an experiment in a world of its own."""
        own = world_seed(seed, number)
        world = make_world(own, (parameters or HighwayParameters()).world)
        return cls(number, own, world, make_drive(world, own, 0, parameters))


def run_drive(seed: int, drive: int, particles: int, parameters: HighwayParameters | None = None) -> Outcome:
    """Simulate one drive in a world of its own and run the filter over it."""
    return run_filter(Run.simulate(seed, drive, parameters), FilterParameters(particles=particles))


def run_filter(run: Run, parameters: FilterParameters) -> Outcome:
    """Run the filter over a simulated drive."""
    world, log = run.world, run.drive
    rng = np.random.default_rng(np.random.SeedSequence([run.seed, 2, 0]))
    car = SlamcuFilter(world.hd_map, log.header, parameters, rng=rng)
    truth = world.frame.to_local(log.reference.lon, log.reference.lat)
    reports: list[tuple[PassReport, bool]] = []
    pose_times, pose_errors, steps, step = [], [], [], 0.0
    for record in log.records:
        begin = perf_counter()
        ended = car.feed(record)
        step += perf_counter() - begin
        reports += [(report, car.health_of_passes.trusted) for report in ended]
        if isinstance(record, DetectionFrame):
            # A step is a camera frame with all that came since the last one: odometry, GNSS, objects.
            steps.append(1e3 * step)
            step = 0.0
            if len(steps) % _POSE_EVERY == 0:
                pose = car.pose
                east, north = world.frame.to_local(pose.lon, pose.lat).tolist()
                true = [float(np.interp(record.t, log.reference.t, truth[:, axis])) for axis in (0, 1)]
                pose_times.append(record.t)
                pose_errors.append(float(np.hypot(east - true[0], north - true[1])))
    reports += [(report, car.health_of_passes.trusted) for report in car.finish()]
    facts = facts_of(world, log)
    estimates = [estimate for estimate in car.features() if estimate.feature is None or not estimate.feature.watched]
    claims = claims_of(world, estimates)
    outcome = score(facts, claims, radius_m=HIGHWAY_RADIUS_M)
    oracle = oracle_errors(world, log)
    return Outcome(
        name=f"drive {run.number} (world seed {run.seed})",
        score=outcome,
        pose_errors_m=tuple(pose_errors),
        oracle_errors_m=tuple(oracle[match.fact] for match in outcome.matches if match.fact in oracle),
        oracle_errors_all_m=tuple(oracle.values()),
        single_sighting_m=tuple(single_sighting_errors(world, log).tolist()),
        step_ms=np.array(steps),
        trust=Trust(
            told=judge(reports, facts, world.frame.to_local, start=log.header.start_time, radius_m=HIGHWAY_RADIUS_M),
            diverged=not _rmse(pose_errors) <= DIVERGED_RMSE_M,
            lost_at=lost_at(np.array(pose_times), np.array(pose_errors), DIVERGED_RMSE_M),
        ),
        records=feature_records(run.number, log, (facts, estimates, claims), score=outcome, oracle=oracle),
    )


def run_drives(
    drives: int,
    seed: int,
    particles: int,
    *,
    jobs: int = 1,
    parameters: HighwayParameters | None = None,
    done: Callable[[], None] = lambda: None,
) -> list[Outcome]:
    """Run drives, `jobs` at a time, and return their outcomes in order; `done` is called after each."""
    if jobs <= 1:
        return list(_one_by_one(drives, seed, particles, parameters, done))
    calls = [partial(run_drive, seed, drive, particles, parameters) for drive in range(drives)]
    return run_all(jobs, calls, done)


def _one_by_one(
    drives: int, seed: int, particles: int, parameters: HighwayParameters | None, done: Callable[[], None]
) -> Iterator[Outcome]:
    for drive in range(drives):
        yield run_drive(seed, drive, particles, parameters)
        done()


def _error_over_oracle(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return how far off new signs are, over how far the oracle is with the same ones, and its interval by drive."""
    ours, oracle = [], []
    for outcome in outcomes:
        pairs = [(r.position_error_m, r.oracle_error_m) for r in outcome.records]
        both = [(our, true) for our, true in pairs if our is not None and true is not None]
        ours.append(sum(our for our, _ in both))
        oracle.append(sum(true for _, true in both))
    ratio = sum(ours) / sum(oracle) if sum(oracle) > 0 else float("nan")
    return {"ratio": ratio, "ci95": list(cluster_interval(ours, oracle))}


def paper_figures(outcomes: Sequence[Outcome], particles: int) -> dict[str, Any]:
    """Return every figure of the evaluation contract's `paper`, over all drives, diverged ones included."""
    scores = [outcome.score for outcome in outcomes]
    result = figures(scores)
    false_new = result.pop("false_new")
    pose_errors = np.concatenate([outcome.pose_errors_m for outcome in outcomes])
    steps = np.concatenate([outcome.step_ms for outcome in outcomes])
    diverged = [outcome.name for outcome in outcomes if outcome.diverged]
    return {
        "drives": len(outcomes),
        **result,
        "accuracy_ci95": list(cluster_interval([s.right for s in scores], [len(s.said) for s in scores])),
        "false_new_per_drive": false_new / len(outcomes),
        "oracle_error_m": summarize([e for outcome in outcomes for e in outcome.oracle_errors_m]),
        "error_over_oracle": _error_over_oracle(outcomes),
        "oracle_error_all_m": summarize([e for outcome in outcomes for e in outcome.oracle_errors_all_m]),
        "single_sighting_error_m": summarize([e for outcome in outcomes for e in outcome.single_sighting_m]),
        "localization_rmse_m": float(np.sqrt(np.mean(pose_errors**2))),
        "diverged_drives": len(diverged),
        "diverged_names": diverged,
        "step_ms": {
            "mean": float(steps.mean()),
            "p50": float(np.percentile(steps, 50)),
            "p99": float(np.percentile(steps, 99)),
        },
        "particles": particles,
        "curves": feature_curves([record for outcome in outcomes for record in outcome.records]),
        "health": trust_figures([outcome.trust for outcome in outcomes]),
        "machine": machine(),
    }
