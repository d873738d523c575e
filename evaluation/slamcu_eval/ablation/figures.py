"""The figures of an ablation: per variant what was right, and by how much that differs from the filter as it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slamcu_eval.ablation.experiment import Cell
from slamcu_eval.ablation.variants import FULL, VARIANTS
from slamcu_eval.machine import machine
from slamcu_eval.score import figures
from slamcu_eval.statistics import cluster_interval


def ablation_figures(cells: Sequence[Cell]) -> dict[str, Any]:
    """Return the figures by world and variant.

    Drives are the same for all variants, so the interval of a change comes from resampling the drives' differences.
    """
    worlds = list(dict.fromkeys(cell.world for cell in cells))
    result: dict[str, Any] = {world: _world([cell for cell in cells if cell.world == world]) for world in worlds}
    return {**result, "machine": machine()}


def _world(cells: Sequence[Cell]) -> dict[str, Any]:
    by_variant = {name: [cell for cell in cells if cell.variant == name] for name in VARIANTS}
    full = by_variant[FULL]
    return {name: _variant(name, some, full) for name, some in by_variant.items() if some}


def _variant(name: str, cells: Sequence[Cell], full: Sequence[Cell]) -> dict[str, Any]:
    scores = [cell.score for cell in cells]
    told = figures(scores)
    totals = [len(score.said) for score in scores]
    return {
        "label": VARIANTS[name].label,
        "drives": len(cells),
        "features": told["features"],
        "accuracy": told["accuracy"],
        **_change(cells, full, totals),
        "confusion": told["confusion"],
        "false_new_per_drive": told["false_new"] / len(cells),
        "new_position_error_m": told["new_position_error_m"]["mean"],
        "ellipse95_coverage": told["ellipse95_coverage"],
        "pose_rmse_median_m": float(np.median([cell.pose_rmse_m for cell in cells])),
        "diverged_drives": sum(cell.diverged for cell in cells),
        "step_ms": float(np.mean([cell.step_ms for cell in cells])),
    }


def _change(cells: Sequence[Cell], full: Sequence[Cell], totals: Sequence[int]) -> dict[str, Any]:
    """Return the change of accuracy against the filter as it is, if that was run on the same drives."""
    right = {cell.drive: cell.score.right for cell in full}
    if {cell.drive for cell in cells} != set(right):
        return {}
    gains = [cell.score.right - right[cell.drive] for cell in cells]
    return {"accuracy_change": sum(gains) / sum(totals), "accuracy_change_ci95": list(cluster_interval(gains, totals))}
