"""What no law can beat: CUSUM, whose worst mean delay is the least of all that raise no more false alarms.

Lorden (1971) showed it asymptotically, Moustakides (1986) exactly: among all stopping rules with a mean time to a false
alarm of at least T, CUSUM with the threshold that gives T has the least worst-case mean delay. It knows both rates,
which the evidence law does not.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

_GRID = 200  # states per unit of log likelihood ratio
_HIGHEST = 40 * _GRID


@lru_cache(maxsize=1024)
def least_delay(before: float, after: float, false_alarms_per_pass: float) -> float:
    """Return the least worst-case mean delay, in passes, of all rules that raise false alarms no more often.

    Passes are misses with probability `before`, and `after` once the change has come. S ← max(S + LLR, 0), alarm at
    S >= h. Passes come one by one, so not every rate has a threshold of its own: between the two that enclose it the
    delay is interpolated over the logarithm of the rate. NaN for a rate that is not within (0, 1).
    """
    if not 0.0 < false_alarms_per_pass < 1.0:
        return float("nan")
    up = round(_GRID * np.log(after / before))
    down = round(_GRID * np.log((1.0 - before) / (1.0 - after)))
    wanted = 1.0 / false_alarms_per_pass
    low, high = 0, 1  # thresholds with too short and long enough a time to a false alarm
    while _mean_time(high, up, down, before) < wanted:
        low, high = high, 2 * high
        if high > _HIGHEST:
            return float("nan")
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if _mean_time(middle, up, down, before) < wanted else (low, middle)
    if not low:
        return _mean_time(high, up, down, after)
    times = [np.log(_mean_time(h, up, down, before)) for h in (low, high)]
    ends = [_mean_time(h, up, down, after) for h in (low, high)]
    return float(np.interp(np.log(wanted), times, ends))


def _mean_time(h: int, up: int, down: int, probability: float) -> float:
    """Return the mean number of steps from S = 0 to S >= h."""
    states = np.arange(h)
    rises, falls = states + up, np.maximum(states - down, 0)
    inside = rises < h
    rows = np.concatenate([states, states, states[inside]])
    columns = np.concatenate([states, falls, rises[inside]])
    values = np.concatenate([np.ones(h), np.full(h, probability - 1.0), np.full(int(inside.sum()), -probability)])
    system = coo_array((values, (rows, columns)), shape=(h, h)).tocsc()
    return float(np.atleast_1d(spsolve(system, np.ones(h)))[0])
