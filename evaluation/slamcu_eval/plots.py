"""The plots of the documentation, drawn from the JSON of the commands: nothing is measured here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slamcu_eval.plot_style import BLUE, GREEN, GREY, ORANGE, Figures, axes
from slamcu_eval.plots_attack import attack
from slamcu_eval.plots_cloud import fleet, law
from slamcu_eval.score import ALWAYS

_STYLE = dict(zip(ALWAYS, ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^")), strict=True))
_SHIFT = dict(zip(ALWAYS, (-0.12, 0.0, 0.12), strict=True))
_DPI = 130


def draw_all(results: dict[str, Figures], folder: Path) -> dict[str, Path]:
    """Draw every plot whose results are there.

    Parameters
    ----------
    results : the JSON of commands by the name of their file: ``paper``, ``mrclam-150``, ``mrclam-600``,
        ``bench-curves``,
        ``law``, ``fleet``, ``fleet-common-bias``.

    Returns the files by the name of the plot.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn: dict[str, Path] = {}
    for name, draw in PLOTS.items():
        figure = draw(results)
        if figure is not None:
            drawn[name] = folder / f"{name}.png"
            # no software version in the file: the same figures give the same bytes
            figure.savefig(drawn[name], dpi=_DPI, metadata={"Software": None})
            plt.close(figure)
    return drawn


def accuracy(results: dict[str, Figures]) -> Figure | None:
    """Draw accuracy by the least range in view and by the share of the pass that traffic hid."""
    if "paper" not in results:
        return None
    curves = results["paper"]["curves"]
    figure, (by_range, by_hidden) = axes(10.5, 4.2, 2)
    ranges = sorted({(p["low"], p["high"]) for kind in ALWAYS for p in curves["accuracy_by_range"][kind]})
    _accuracy_panel(by_range, curves["accuracy_by_range"], ranges, [f"{a:g}–{b:g}" for a, b in ranges])
    by_range.set_xlabel("least range at which the feature was in view, m")
    by_range.set_ylabel("features told as they are, %")
    hidden = sorted({(p["low"], p["high"]) for kind in ALWAYS for p in curves["accuracy_by_hidden_share"][kind]})
    names = [_hidden_name(low, high) for low, high in hidden]
    _accuracy_panel(by_hidden, curves["accuracy_by_hidden_share"], hidden, names)
    by_hidden.set_xlabel("share of the frames in view in which traffic hid it")
    by_range.set_ylim(50.0, 101.5)
    by_hidden.set_ylim(0.0, 103.0)
    by_range.legend(loc="lower left", frameon=False)
    figure.suptitle(_sample(results["paper"], "95 % intervals by drive; counts of features below"), fontsize=10)
    return figure


def _hidden_name(low: float, high: float) -> str:
    if high < 0.01:
        return "none"
    return "all" if low > 0.99 else f"{100 * low:.0f} to {100 * high:.0f} %"


def _accuracy_panel(ax: Axes, curves: Figures, bins: Sequence[tuple[float, float]], names: Sequence[str]) -> None:
    for kind, (colour, marker) in _STYLE.items():
        points = curves[kind]
        x = np.array([bins.index((p["low"], p["high"])) for p in points]) + _SHIFT[kind]
        y, interval = _percent(points, "accuracy")
        ax.errorbar(x, y, interval, color=colour, marker=marker, capsize=3, linewidth=1.4, label=kind)
    counts = [sum(p["count"] for kind in ALWAYS for p in curves[kind] if (p["low"], p["high"]) == one) for one in bins]
    ax.set_xticks(range(len(bins)), [f"{name}\n({count})" for name, count in zip(names, counts, strict=True)])
    ax.tick_params(axis="x", labelsize=8.5)


def _percent(points: Sequence[Figures], name: str) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return values in percent, and how far their intervals reach below and above, (2, N)."""
    y = 100.0 * np.array([p[name] for p in points])
    low, high = 100.0 * np.array([p["ci95"] for p in points]).reshape(-1, 2).T
    return y, np.maximum(np.stack([y - low, high - y]), 0.0)


def position_error(results: dict[str, Figures]) -> Figure | None:
    """Draw the error of new features by the number of sightings, beside the oracle's."""
    if "paper" not in results:
        return None
    paper = results["paper"]
    points = [p for p in paper["curves"]["error_by_sightings"] if p["found"]]
    figure, (ax,) = axes(7.0, 4.2)
    x = np.arange(len(points))
    for name, label, colour, marker, shift in (
        ("error_m", "filter", BLUE, "o", -0.08),
        ("oracle_error_m", "least squares with the true poses", ORANGE, "s", 0.08),
    ):
        middle = np.array([p[name]["median"] for p in points], float)
        spread = [[p[name]["median"] - p[name]["p25"], p[name]["p75"] - p[name]["median"]] for p in points]
        ax.errorbar(
            x + shift,
            middle,
            np.array(spread, float).T,
            color=colour,
            marker=marker,
            capsize=3,
            linewidth=1.4,
            label=label,
        )
    single = paper["single_sighting_error_m"]["median"]
    ax.axhline(single, color=GREY, linestyle="--", linewidth=1.2, label="a single sighting, true pose (median)")
    labels = [f"{p['low']}–{p['high']}" if p["high"] < 900 else f"{p['low']}+" for p in points]
    counts = [f"({p['found']} of {p['count']})" for p in points]
    ax.set_xticks(x, [f"{label}\n{count}" for label, count in zip(labels, counts, strict=True)], fontsize=8.5)
    ax.set_xlabel("detections of the sign in the drive (found of all new signs)")
    ax.set_ylabel("position error, m (median and quartiles)")
    ax.set_ylim(0.0, 1.3 * max(single, ax.get_ylim()[1] / 1.05))
    ax.legend(framealpha=1.0, edgecolor="none", loc="upper right")
    figure.suptitle(_sample(paper, "new signs"), fontsize=10)
    return figure


def reliability(results: dict[str, Figures]) -> Figure | None:
    """Draw how often features stood that were believed in to a degree, and how many there were."""
    if "paper" not in results:
        return None
    paper = results["paper"]
    points = paper["curves"]["reliability"]
    figure, (ax, counts) = axes(10.0, 4.4, 2)
    ax.plot([0, 100], [0, 100], color=GREY, linestyle="--", linewidth=1.2, label="as often as believed")
    y, interval = _percent(points, "stood")
    believed = 100.0 * np.array([p["belief"] for p in points])
    ax.errorbar(believed, y, interval, color=BLUE, marker="o", capsize=3, linewidth=1.4, label="features")
    ax.set_xlabel("belief that the feature stands, e + u/2, %")
    ax.set_ylabel("features that stood, %")
    ax.set_ylim(-3.0, 108.0)
    ax.legend(frameon=False, loc="upper left")
    middle = [50.0 * (p["low"] + p["high"]) for p in points]
    counts.bar(middle, [p["count"] for p in points], width=8.5, color=BLUE)
    counts.set_yscale("log")
    counts.set_xlim(0.0, 100.0)
    counts.set_xlabel("belief that the feature stands, e + u/2, %")
    counts.set_ylabel("features")
    figure.suptitle(_sample(paper, "map features and claims of new ones; 95 % intervals by drive"), fontsize=10)
    return figure


def _sample(paper: Figures, what: str) -> str:
    return f"Simulated motorway, {paper['drives']} drives, {paper['features']} features: {what}"


def step_time(results: dict[str, Figures]) -> Figure | None:
    """Draw the time of a step by the size of the map and the length of the drive, and what a long session holds."""
    bench = results.get("bench-curves")
    if not bench:
        return None
    figure, (by_map, by_drive, memory) = axes(12.0, 4.0, 3)
    for ax, name, label in (
        (by_map, "map_size", "features in the map"),
        (by_drive, "drive_length", "kilometres driven before"),
    ):
        steps = {float(at): ms for at, ms in bench[name]["step_ms"].items()}
        ax.plot(list(steps), list(steps.values()), color=BLUE, marker="o")
        ax.set_xscale("log")
        ax.set_xlabel(label)
        ax.set_ylabel("time of a step, ms (median of rounds in turn)")
        ax.set_ylim(bottom=0.0, top=1.5 * max(steps.values()))
    memory.plot(bench["memory"]["hours"], bench["memory"]["memory_mb"], color=BLUE, marker="o")
    memory.set_xlabel("hours driven")
    memory.set_ylabel("what the filter holds beside the map, MB")
    memory.set_ylim(bottom=0.0)
    return figure


def robots(results: dict[str, Figures]) -> Figure | None:
    """Draw what one robot gets right and what the fleet does, by session and duration."""
    names = [name for name in ("mrclam-150", "mrclam-600") if name in results]
    if not names:
        return None
    figure, panels = axes(max(4.6 * len(names), 6.5), 4.0, len(names), sharey=True)
    for ax, name in zip(panels, names, strict=True):
        blocks = {**{f"session {key}": block for key, block in results[name]["sessions"].items()}}
        blocks["pooled"] = results[name]["pooled"]
        x = np.arange(len(blocks))
        for part, label, colour, hatch, shift in (
            ("single", "one robot", ORANGE, "//", -0.19),
            ("fused", "the fleet", BLUE, "", 0.19),
        ):
            y, interval = _percent(
                [block[part] | {"ci95": block[part]["accuracy_ci95"]} for block in blocks.values()], "accuracy"
            )
            bars = ax.bar(x + shift, y, 0.36, color=colour, hatch=hatch, edgecolor="white", label=label)
            ax.errorbar(x + shift, y, interval, fmt="none", ecolor="black", capsize=3, linewidth=1.0)
            ax.bar_label(
                bars,
                [f"{value:.1f}" for value in y],
                label_type="center",
                color="black",
                fontsize=9,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5},
            )
        ax.set_xticks(x, list(blocks))
        ax.set_title(f"{name.removeprefix('mrclam-')} s", fontsize=10)
    panels[0].set_ylabel("landmarks told as they are, %")
    panels[0].set_ylim(0.0, 104.0)
    panels[0].legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)
    figure.suptitle("Recorded robots against wrong maps; 95 % intervals by run and by map", fontsize=10)
    return figure


PLOTS: dict[str, Callable[[dict[str, Figures]], Figure | None]] = {
    "accuracy": accuracy,
    "position-error": position_error,
    "reliability": reliability,
    "step-time": step_time,
    "robots": robots,
    "law": law,
    "fleet": fleet,
    "attack": attack,
}
