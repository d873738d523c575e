"""Summaries of errors and intervals that respect that features of one drive share its luck."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

_DRAWS = 10_000
_SEED = 20_180_917  # intervals are figures too: the same outcomes give the same interval


def summarize(errors: ArrayLike) -> dict[str, float]:
    """Return mean, median, 95th percentile and standard deviation; all NaN if there are no errors."""
    values = np.asarray(errors, float)
    if values.size == 0:
        return dict.fromkeys(("mean", "median", "p95", "std"), float("nan"))
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "std": float(values.std()),
    }


def cluster_interval(
    hits: Sequence[float], totals: Sequence[float], level: float = 0.95, draws: int = _DRAWS
) -> tuple[float, float]:
    """Return the bootstrap interval of sum(hits) / sum(totals), resampling whole clusters (drives, worlds).

    Parameters
    ----------
    hits, totals : per cluster, of one length.
    level : share of the resampled ratios inside the interval.
    """
    numerator, denominator = np.asarray(hits, float), np.asarray(totals, float)
    if denominator.sum() <= 0:
        return float("nan"), float("nan")
    rng = np.random.default_rng(_SEED)
    picks = rng.integers(0, numerator.size, (draws, numerator.size))
    below = denominator[picks].sum(axis=1)
    ratios = numerator[picks].sum(axis=1)[below > 0] / below[below > 0]
    low, high = np.percentile(ratios, [50 * (1 - level), 50 * (1 + level)])
    return float(low), float(high)
