"""How right the filter is by what a feature was like to see: the curves that plots draw, from a record per feature."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from slamcu_eval.records import NOTHING, FeatureRecord
from slamcu_eval.score import ALWAYS
from slamcu_eval.statistics import cluster_interval

Curve = list[dict[str, Any]]
Value = Callable[[FeatureRecord], float | None]

RANGE_EDGES_M = (0.0, 15.0, 20.0, 25.0, 30.0, 40.0, 80.0)  # least range in view: the far ones are those by the lane
HIDDEN_EDGES = (0.0, 1e-9, 0.5, 1.0 - 1e-9, 1.0)  # not at all, less than half, more, throughout
SIGHTING_EDGES = (1, 5, 10, 15, 20, 25, 30, 40, 1_000)
MASS_EDGES = tuple(round(0.1 * step, 1) for step in range(11))


def feature_curves(records: Sequence[FeatureRecord]) -> dict[str, Any]:
    """Return the curves of an experiment; each point has the bounds of its bin, low included, and its count."""
    world = [record for record in records if record.truth != NOTHING]
    return {
        "accuracy_by_range": {kind: _by_range([one for one in world if one.truth == kind]) for kind in ALWAYS},
        "accuracy_by_hidden_share": {
            kind: _accuracy([one for one in world if one.truth == kind], lambda one: one.hidden_share, HIDDEN_EDGES)
            for kind in ALWAYS
        },
        "error_by_sightings": _errors(world),
        "reliability": _reliability(records),
    }


def _by_range(records: Sequence[FeatureRecord]) -> Curve:
    return _accuracy(records, lambda one: one.closest_m, RANGE_EDGES_M)


def _binned(
    records: Sequence[FeatureRecord], value: Value, edges: Sequence[float]
) -> list[tuple[float, float, list[FeatureRecord]]]:
    """Return bounds and records of each bin that is not empty; the last bin holds its upper bound too."""
    known = [(float(x), record) for record in records if (x := value(record)) is not None]
    result = []
    for low, high in pairwise(edges):
        inside = [one for x, one in known if low <= x < high or (x == high == edges[-1])]
        if inside:
            result.append((low, high, inside))
    return result


def _accuracy(records: Sequence[FeatureRecord], value: Value, edges: Sequence[float]) -> Curve:
    curve = []
    for low, high, inside in _binned(records, value, edges):
        share, interval = _share(inside, lambda one: one.truth == one.predicted)
        curve.append({"low": low, "high": high, "count": len(inside), "accuracy": share, "ci95": interval})
    return curve


def _share(records: Sequence[FeatureRecord], counts: Callable[[FeatureRecord], bool]) -> tuple[float, list[float]]:
    """Return the share of records that count, and its interval by drive."""
    drives = sorted({record.drive for record in records})
    hits = [sum(counts(one) for one in records if one.drive == drive) for drive in drives]
    totals = [sum(one.drive == drive for one in records) for drive in drives]
    return sum(hits) / sum(totals), list(cluster_interval(hits, totals))


def _errors(world: Sequence[FeatureRecord]) -> Curve:
    new = [record for record in world if record.truth == "new"]
    curve = []
    for low, high, inside in _binned(new, lambda one: one.sightings, SIGHTING_EDGES):
        found = [one for one in inside if one.position_error_m is not None]
        curve.append(
            {
                "low": int(low),
                "high": int(high) - 1,
                "count": len(inside),
                "found": len(found),
                "error_m": _quartiles([one.position_error_m for one in found]),
                "oracle_error_m": _quartiles([one.oracle_error_m for one in found]),
            }
        )
    return curve


def _quartiles(errors: Sequence[float | None]) -> dict[str, float]:
    values = [error for error in errors if error is not None]
    if not values:
        return dict.fromkeys(("p25", "median", "p75"), float("nan"))
    return dict(zip(("p25", "median", "p75"), np.percentile(values, (25, 50, 75)).tolist(), strict=True))


def _reliability(records: Sequence[FeatureRecord]) -> Curve:
    """Return how often a feature stood that was given a belief e + u/2, over features of the map and claims of new."""
    told = [one for one in records if one.exists is not None and (one.truth in ALWAYS or one.predicted == "new")]
    curve = []
    for low, high, inside in _binned(told, _belief, MASS_EDGES):
        stood, interval = _share(inside, lambda one: one.truth in {"normal", "new"})
        belief = float(np.mean([_belief(one) for one in inside]))
        point = {"low": low, "high": high, "count": len(inside), "belief": belief, "stood": stood, "ci95": interval}
        curve.append(point)
    return curve


def _belief(record: FeatureRecord) -> float:
    return (record.exists or 0.0) + 0.5 * (record.unknown or 0.0)
