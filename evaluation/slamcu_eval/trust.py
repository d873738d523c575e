"""Whether the filter knew when it was lost: its verdict on itself, report by report, beside the truth.

A report says of a feature what has the largest mass by this pass alone; a tentative one says nothing. It is *wrong* if
it contradicts the truth: it denies a feature that stands, confirms one that is gone, tells of a new one where none is,
or takes back a new one that is there. A run is *lost* from the first moment at which its pose is off by more than the
limit that makes a run diverged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamcu_core.evidence import Existence, Masses
from slamcu_core.reports import PassReport
from slamcu_eval.score import Fact

Array = NDArray[np.float64]
ToLocal = Callable[[float, float], Array]  # longitude, latitude (degrees) to (2,) m in the frame of the facts


@dataclass(frozen=True, slots=True)
class ToldPass:
    """One report as the cloud gets it."""

    t: float  # s since the start of the drive, end of the pass
    trusted: bool  # what the filter said of itself
    wrong: bool


@dataclass(frozen=True, slots=True)
class Trust:
    """What one run reported, and whether it was lost."""

    told: tuple[ToldPass, ...]
    diverged: bool
    lost_at: float  # s; inf if never

    @property
    def flagged(self) -> bool:
        """Whether any report came with a warning."""
        return any(not one.trusted for one in self.told)

    @property
    def flagged_while_right(self) -> bool:
        """Whether any report came with a warning before the pose had ever been off."""
        return any(not one.trusted and one.t < self.lost_at for one in self.told)

    @property
    def wrong_when_lost(self) -> tuple[ToldPass, ...]:
        """The wrong reports of a lost filter."""
        return tuple(one for one in self.told if one.wrong and one.t >= self.lost_at)

    @property
    def flagged_before_wrong(self) -> bool:
        """Whether a warning came no later than the first wrong report of the lost filter."""
        wrong = self.wrong_when_lost
        return any(not one.trusted and (not wrong or one.t <= wrong[0].t) for one in self.told)


def judge(
    reports: Iterable[tuple[PassReport, bool]],
    facts: Sequence[Fact],
    to_local: ToLocal,
    *,
    start: datetime,
    radius_m: float,
) -> tuple[ToldPass, ...]:
    """Hold reports, each with the filter's trust in itself, against the truth."""
    judge_one = _Judge(facts, to_local, radius_m)
    return tuple(
        ToldPass((report.ended_at - start).total_seconds(), trusted, judge_one.wrong(report))
        for report, trusted in reports
    )


class _Judge:
    """The truth, by object id and by place."""

    def __init__(self, facts: Sequence[Fact], to_local: ToLocal, radius_m: float) -> None:
        self._stands = {f.object_id: f.kind in {"normal", "modified"} for f in facts if f.object_id is not None}
        self._new = np.array([f.place for f in facts if f.kind in {"new", "moved"}], float).reshape(-1, 2)
        self._to_local, self._radius = to_local, radius_m

    def wrong(self, report: PassReport) -> bool:
        """Tell whether a report contradicts the truth; one that tells too little contradicts nothing."""
        said = Masses.from_weights(report.weight_for, report.weight_against).state
        if said is Existence.TENTATIVE:
            return False
        if report.reference is not None:
            there = self._stands.get(report.reference.object_id, False)
        elif report.position is not None:
            place = self._to_local(report.position.lon, report.position.lat)
            there = bool((np.hypot(*(self._new - place).T) <= self._radius).any())
        else:
            return False
        return there != (said is Existence.EXISTENT)


def lost_at(times: Array, errors: Array, limit_m: float) -> float:
    """Return the first of the times (K,) at which the pose error (K,) exceeds a limit; inf if it never does."""
    beyond = np.flatnonzero(~(np.asarray(errors) <= limit_m))
    return float(times[beyond[0]]) if beyond.size else float("inf")


def trust_figures(runs: Sequence[Trust]) -> dict[str, Any]:
    """Return how well the filter's trust in itself told the lost from the healthy; a share of nothing is NaN."""
    diverged, healthy = [run for run in runs if run.diverged], [run for run in runs if not run.diverged]
    told = [one for run in runs for one in run.told]
    wrong_when_lost = [one for run in runs for one in run.wrong_when_lost]
    return {
        "diverged_runs": len(diverged),
        "diverged_flagged": _share([run.flagged for run in diverged]),
        "diverged_flagged_before_wrong": _share([run.flagged_before_wrong for run in diverged]),
        "diverged_without_wrong_report": sum(not run.wrong_when_lost for run in diverged),
        "healthy_runs": len(healthy),
        "healthy_flagged": _share([run.flagged for run in healthy]),
        "healthy_flagged_while_right": _share([run.flagged_while_right for run in healthy]),
        "healthy_reports_flagged": _share([not one.trusted for run in healthy for one in run.told]),
        "reports": {
            "all": len(told),
            "flagged": sum(not one.trusted for one in told),
            "wrong": sum(one.wrong for one in told),
            "wrong_flagged": sum(one.wrong and not one.trusted for one in told),
            "wrong_when_lost": len(wrong_when_lost),
            "wrong_when_lost_flagged": sum(not one.trusted for one in wrong_when_lost),
        },
    }


def _share(flags: Sequence[bool]) -> float:
    return sum(flags) / len(flags) if flags else float("nan")
