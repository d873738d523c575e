"""The tables of the documentation, written between marks from the JSON of the commands.

A document says ``<!-- begin NAME -->`` and ``<!-- end NAME -->``; what stands between is replaced. So no figure is ever
copied by hand, and one that has not been measured is a gap that says which command fills it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from slamcu_core.errors import FormatError
from slamcu_eval.table_cells import Figures, gap, number, share, table_of
from slamcu_eval.tables_attack import attack, attack_cost
from slamcu_eval.tables_cloud import fleet, law

_MARK = re.compile(r"(<!-- begin ([a-z0-9-]+) -->\n).*?(<!-- end \2 -->)", re.DOTALL)


def fill(text: str, results: dict[str, Figures], *, source: str) -> str:
    """Return a document with its marked tables filled; raises FormatError for a mark that names no table."""

    def replace(match: re.Match[str]) -> str:
        table = TABLES.get(match[2])
        if table is None:
            raise FormatError(f"expected a mark of {', '.join(TABLES)}, got {match[2]}", source=source)
        return f"{match[1]}{table(results)}\n{match[3]}"

    return _MARK.sub(replace, text)


def _between(interval: Sequence[float | None], factor: float = 100.0, decimals: int = 1) -> str:
    low, high = (number(None if end is None else factor * end, decimals) for end in interval)
    return f"{low} to {high}"


def paper(results: dict[str, Figures]) -> str:
    """Return the paper's experiment beside what was published."""
    if "paper" not in results:
        return gap("paper")
    f = results["paper"]
    error, oracle, single = (f[f"{name}_error_m"] for name in ("new_position", "oracle", "single_sighting"))
    step = f["step_ms"]
    return table_of(
        ("figure", "here", "published 2018"),
        [
            ("drives, features", f"{f['drives']}, {f['features']}", "1, 103"),
            ("features told as they are", share(f["accuracy"]), "96.12 %"),
            ("95 % interval, by drive", f"{_between(f['accuracy_ci95'])} %", "90.4 to 98.5 %"),
            ("false new features per drive", number(f["false_new_per_drive"]), ""),
            (
                "error of new signs, mean and standard deviation",
                f"{error['mean']:.2f} and {error['std']:.2f} m",
                "0.8 and 0.9 m",
            ),
            ("the same by least squares with the true poses (oracle), mean", number(oracle["mean"], 2, " m"), ""),
            (
                "error over the oracle's, and 95 % interval by drive",
                f"{number(f['error_over_oracle']['ratio'])} ({_between(f['error_over_oracle']['ci95'], 1.0, 2)})",
                "",
            ),
            ("a single sighting with the true pose, mean", number(single["mean"], 2, " m"), ""),
            ("new signs inside their own 95 % ellipse", share(f["ellipse95_coverage"]), ""),
            ("pose error, root mean square", number(f["localization_rmse_m"], 2, " m"), ""),
            ("diverged drives (above 3 m)", str(f["diverged_drives"]), ""),
            (
                f"step of {f['particles']} particles, mean and 99th percentile",
                f"{step['mean']:.2f} and {step['p99']:.2f} ms",
                "30.39 ms",
            ),
        ],
    )


_STRETCHES = {"mrclam-150": "150 s", "mrclam-600": "600 s", "mrclam-600-later": "600 s from 600 s on"}


def robots(results: dict[str, Figures]) -> str:
    """Return the recorded robots, alone and fused, by duration and session."""
    rows = []
    for name, stretch in _STRETCHES.items():
        if name not in results:
            continue
        blocks = {**results[name]["sessions"], "pooled": results[name]["pooled"]}
        for session, block in blocks.items():
            single, fused = block["single"], block["fused"]
            right = sum(row[truth] for truth, row in fused["confusion"].items())
            total = sum(sum(row.values()) for row in fused["confusion"].values())
            rows.append(
                (
                    f"{stretch}, {'session ' * (session != 'pooled')}{session}",
                    share(single["accuracy"]),
                    f"{single['diverged_runs']} of {single['runs']}",
                    number(single["new_position_error_m"]["mean"], 3, " m"),
                    number(single["pose_rmse_median_m"], 3, " m"),
                    f"{right} of {total}",
                    str(fused["false_new"]),
                )
            )
    head = ("run", "one robot: right", "diverged", "new off by", "pose error", "fleet: right", "fleet: false new")
    return table_of(head, rows) if rows else gap("mrclam")


def health(results: dict[str, Figures]) -> str:
    """Return whether the filter knew when it was lost."""
    found = {
        "motorway": results.get("paper", {}).get("health"),
        **{
            f"robots, {stretch}": results.get(name, {}).get("pooled", {}).get("single", {}).get("health")
            for name, stretch in _STRETCHES.items()
        },
    }
    rows = [
        (
            name,
            str(block["diverged_runs"]),
            share(block["diverged_flagged_before_wrong"]),
            str(block["healthy_runs"]),
            share(block["healthy_flagged"]),
            share(block["healthy_flagged_while_right"]),
            share(block["healthy_reports_flagged"]),
            f"{block['reports']['wrong_when_lost_flagged']} of {block['reports']['wrong_when_lost']}",
        )
        for name, block in found.items()
        if block
    ]
    head = (
        "runs",
        "diverged",
        "of them flagged before a wrong report",
        "healthy",
        "of them flagged",
        "before the pose was ever off",
        "of their reports",
        "wrong reports of lost filters that carry the flag",
    )
    return table_of(head, rows) if rows else gap("paper mrclam")


def _ablation(world: str) -> Callable[[dict[str, Figures]], str]:
    def table(results: dict[str, Figures]) -> str:
        variants = results.get("ablation", {}).get(world)
        return _variants(variants) if variants else gap("ablation")

    return table


def _proposals(world: str) -> Callable[[dict[str, Figures]], str]:
    names = ("full", "motion_prior", "per_particle_association", "greedy_association")

    def table(results: dict[str, Figures]) -> str:
        variants = results.get("ablation", {}).get(world, {})
        some = {name: variants[name] for name in names if name in variants}
        return _variants(some) if some else gap("ablation")

    return table


def _variants(variants: dict[str, Figures]) -> str:
    first = next(iter(variants.values()))
    head = (
        f"{first['drives']} drives, {first['features']} features",
        "right",
        "change in points (95 %)",
        "false new a drive",
        "new off by",
        "in 95 % ellipse",
        "pose error",
        "diverged",
        "step",
    )
    return table_of(
        head,
        [
            (
                one["label"],
                share(one["accuracy"]),
                ""
                if one is first
                else f"{100 * one['accuracy_change']:+.1f} ({_between(one['accuracy_change_ci95'])})",
                number(one["false_new_per_drive"], 1),
                number(one["new_position_error_m"], 2, " m"),
                share(one["ellipse95_coverage"]),
                number(one["pose_rmse_median_m"], 2, " m"),
                str(one["diverged_drives"]),
                number(one["step_ms"], 2, " ms"),
            )
            for one in variants.values()
        ],
    )


TABLES: dict[str, Callable[[dict[str, Figures]], str]] = {
    "paper": paper,
    "robots": robots,
    "health": health,
    "ablation-motorway": _ablation("motorway"),
    "ablation-robots": _ablation("robots"),
    "proposals-motorway": _proposals("motorway"),
    "proposals-robots": _proposals("robots"),
    "law": law,
    "fleet": fleet,
    "attack": attack,
    "attack-cost": attack_cost,
}
