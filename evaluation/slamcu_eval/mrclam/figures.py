"""The figures of the evaluation contract's `mrclam`, per session and pooled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slamcu_eval.machine import machine
from slamcu_eval.mrclam.experiment import FusedMap, RobotRun
from slamcu_eval.score import Score, figures
from slamcu_eval.statistics import cluster_interval
from slamcu_eval.trust import trust_figures


def mrclam_figures(single: Sequence[RobotRun], fused: Sequence[FusedMap]) -> dict[str, Any]:
    """Return every figure; diverged runs are counted and named, and their features count like all others."""
    sessions = sorted({run.session for run in single})
    steps = np.concatenate([run.step_ms for run in single])
    return {
        "sessions": {
            str(session): _block(
                [run for run in single if run.session == session], [one for one in fused if one.session == session]
            )
            for session in sessions
        },
        "pooled": _block(single, fused),
        "step_ms": {
            "mean": float(steps.mean()),
            "p50": float(np.percentile(steps, 50)),
            "p99": float(np.percentile(steps, 99)),
        },
        "machine": machine(),
    }


def _block(single: Sequence[RobotRun], fused: Sequence[FusedMap]) -> dict[str, Any]:
    alone, together = figures([run.score for run in single]), figures([one.score for one in fused])
    diverged = [run.name for run in single if run.diverged]
    return {
        "single": {
            "confusion": alone["confusion"],
            "accuracy": alone["accuracy"],
            "accuracy_ci95": _interval([run.score for run in single]),
            "new_position_error_m": alone["new_position_error_m"],
            "false_new_per_run": alone["false_new"] / len(single),
            "diverged_runs": len(diverged),
            "diverged_names": diverged,
            "runs": len(single),
            "pose_rmse_median_m": float(np.median([run.pose_rmse_m for run in single])),
            "health": trust_figures([run.trust for run in single]),
        },
        "fused": {
            "confusion": together["confusion"],
            "accuracy": together["accuracy"],
            "accuracy_ci95": _interval([one.score for one in fused]),
            "false_new": together["false_new"],
            "new_position_error_m": together["new_position_error_m"],
            "maps": len(fused),
        },
    }


def _interval(scores: Sequence[Score]) -> list[float]:
    return list(cluster_interval([one.right for one in scores], [len(one.said) for one in scores]))
