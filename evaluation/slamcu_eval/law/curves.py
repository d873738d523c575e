"""The curves that the policy is chosen from: false changes against passes to a decision, setting by setting."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slamcu_core.aggregation import ClassPolicy, Side
from slamcu_eval.law.bound import least_delay
from slamcu_eval.law.passes import LONG, Array, Rate, delays, false_changes

MISS_RATES = (0.02, 0.05, 0.10, 0.20)
PHANTOM_RATES = (0.002, 0.005, 0.01, 0.02, 0.05)
TRUSTS = (0.6, 0.7, 0.8)
FORGETTINGS = (0.7, 0.8, 0.9)
ENTERS = (0.7, 0.75, 0.8, 0.85, 0.9, 0.95)
CONTRIBUTORS_NEW = (2, 3)
MISS_RATE, PHANTOM_RATE = 0.05, 0.02  # where the goal is set, and of a place where no sign stands any more
FRESH = 10  # passes over a feature of a fresh map that count
_FEATURES = 2_000  # whose delays are measured


@dataclass(frozen=True, slots=True)
class Setting:
    """One point of a curve."""

    side: Side
    policy: ClassPolicy
    miss_rate: float
    phantom_rate: float


def settings(default: ClassPolicy) -> list[Setting]:
    """Return every setting that is looked at: the default under all rates, and other policies around it."""
    result = [
        Setting(Side.DELETED, replace(default, enter=enter), miss, PHANTOM_RATE)
        for miss in MISS_RATES
        for enter in sorted({*ENTERS, default.enter})
    ]
    result += [
        Setting(
            Side.DELETED, replace(default, trust=trust, forgetting=forgetting, enter=enter), MISS_RATE, PHANTOM_RATE
        )
        for trust in TRUSTS
        for forgetting in FORGETTINGS
        for enter in ENTERS
        if (trust, forgetting) != (default.trust, default.forgetting)
    ]
    result += [
        Setting(Side.NEW, replace(default, enter=enter, contributors_new=count), MISS_RATE, phantom)
        for phantom in PHANTOM_RATES
        for enter, count in sorted(
            {(enter, count) for enter in (0.8, 0.9, 0.95) for count in CONTRIBUTORS_NEW}
            | {(default.enter, default.contributors_new)}
        )
    ]
    return result


def law_curves(
    default: ClassPolicy, *, passes: int, seed: int, done: Callable[[], None] = lambda: None
) -> Iterator[dict[str, Any]]:
    """Yield the figures of every setting; the default's own are counted over ten times as many passes."""
    all_settings = settings(default)
    # each setting has draws of its own: neighbouring rows, and neighbouring seeds, share none
    for setting, stream in zip(all_settings, np.random.SeedSequence(seed).spawn(len(all_settings)), strict=True):
        count = 10 * passes if setting.policy == default else passes
        yield point(setting, passes=count, stream=stream)
        done()


def point(setting: Setting, *, passes: int, stream: np.random.SeedSequence) -> dict[str, Any]:
    """Return the figures of one setting."""
    policy, side = setting.policy, setting.side
    deleted = side is Side.DELETED
    rate = setting.miss_rate if deleted else setting.phantom_rate
    starts = {"fresh": (0, FRESH), "long": (LONG, LONG)} if deleted else {"fresh": (0, FRESH)}
    figures: dict[str, Any] = {
        "side": side.value,
        "miss_rate": setting.miss_rate,
        "phantom_rate": setting.phantom_rate,
        "trust": policy.trust,
        "forgetting": policy.forgetting,
        "enter": policy.enter,
        "contributors": policy.contributors_deleted if deleted else policy.contributors_new,
        "passes": passes,
        "false_per_10000": {},
        "passes_to_decision": {},
    }
    rates: dict[str, Rate] = {}
    for name, (after, length) in starts.items():
        alarms, waits = stream.spawn(2)
        rates[name] = false_changes(policy, side, rate, passes=passes, after=after, length=length, stream=alarms)
        taken = delays(
            policy,
            side,
            miss_rate=setting.miss_rate,
            phantom_rate=setting.phantom_rate,
            before=after,
            features=_FEATURES,
            stream=waits,
        )
        figures["false_per_10000"][name] = rates[name].per_10000
        figures["passes_to_decision"][name] = _summary(taken)
    if deleted:
        # no event seen: the rate is below one in all passes, and the bound at that rate flatters no one
        at = max(rates["long"].events, 1) / rates["long"].passes
        bound = least_delay(setting.miss_rate, 1.0 - setting.phantom_rate, at)
        figures["bound_passes"] = bound
        figures["detection_delay_over_bound"] = figures["passes_to_decision"]["long"]["mean"] / bound
    return figures


def bound_curve(miss_rate: float, per_10000: Sequence[float]) -> list[float]:
    """Return CUSUM's delays at rates of false alarms."""
    return [least_delay(miss_rate, 1.0 - PHANTOM_RATE, rate / 1e4) for rate in per_10000]


def _summary(taken: Array) -> dict[str, float]:
    return {
        "mean": float(taken.mean()) if np.isfinite(taken).all() else float("inf"),
        "median": float(np.median(taken)),
        "p95": float(np.quantile(taken, 0.95, method="higher")),
    }
