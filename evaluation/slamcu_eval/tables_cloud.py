"""The tables of the cloud: its law against the bound, and what a growing fleet adds."""

from __future__ import annotations

from typing import Any

from slamcu_eval.table_cells import Figures, gap, number, share, table_of

_KINDS = ("new", "deleted", "moved", "modified")


def law(results: dict[str, Figures]) -> str:
    """Return the default policy under all rates, and thresholds around it."""
    if "law" not in results:
        return gap("law")
    default, points = results["law"]["default"], results["law"]["points"]
    own = [p for p in points if (p["trust"], p["forgetting"]) == (default["trust"], default["forgetting"])]
    rows = [
        (
            f"{p['miss_rate']:.0%} misses, threshold {p['enter']:g}" + ("*" if p["enter"] == default["enter"] else ""),
            number(p["false_per_10000"]["fresh"], 3),
            number(p["false_per_10000"]["long"], 3),
            _passes(p["passes_to_decision"]["fresh"]),
            _passes(p["passes_to_decision"]["long"]),
            number(p["bound_passes"], 2),
            number(p["detection_delay_over_bound"], 2),
        )
        for p in own
        if p["side"] == "deleted" and p["enter"] in {0.8, 0.85, 0.9, default["enter"]}
    ]
    head = (
        "deleted",
        "false per 10⁴, fresh map",
        "long history",
        "passes, fresh map",
        "long history",
        "CUSUM, mean",
        "ratio",
    )
    new = [
        (
            f"{p['phantom_rate']:.1%} phantoms, threshold {p['enter']:g}, {p['contributors']} contributors"
            + ("*" if (p["enter"], p["contributors"]) == (default["enter"], default["contributors_new"]) else ""),
            number(p["false_per_10000"]["fresh"], 3),
            _passes(p["passes_to_decision"]["fresh"]),
        )
        for p in own
        if p["side"] == "new" and p["phantom_rate"] in {0.005, 0.01, 0.02} and p["enter"] < 0.95
    ]
    return table_of(head, rows) + "\n\n" + table_of(("new", "false per 10⁴", "passes"), new)


def fleet(results: dict[str, Figures]) -> str:
    """Return precision, recall and places by the size of the fleet, without and with a common bias."""
    found = {"": results.get("fleet"), "common bias, ": results.get("fleet-common-bias")}
    rows = [
        (
            f"{name}{size}",
            *(_both(block[kind]) for kind in _KINDS),
            f"{number(block['new_position_error_m']['mean'])} ({number(block['new_position_error_m']['p95'])})",
            number(block["oracle_position_error_m"]),
            share(block["ellipse95_coverage"]),
            "/".join(number(block["ece"][kind], 3) for kind in _KINDS),
        )
        for name, figures in found.items()
        if figures is not None
        for size, block in figures["vehicles"].items()
    ]
    head = (
        "vehicles",
        *(f"{kind}: precision, recall, %" for kind in _KINDS),
        "new off by, mean (p95), m",
        "with true poses, m",
        "in 95 % ellipse",
        "ECE, in that order",
    )
    return table_of(head, rows) if rows else gap("fleet")


def _passes(summary: dict[str, Any]) -> str:
    return f"{number(summary['median'], 0)} ({number(summary['p95'], 0)})"


def _both(block: dict[str, Any]) -> str:
    cells = (block["precision"], block["recall"])
    return ", ".join(number(None if value is None else 100.0 * value, 1) for value in cells)
