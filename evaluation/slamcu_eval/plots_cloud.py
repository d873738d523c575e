"""The plots of the cloud: its law against the bound, and what a growing fleet adds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from slamcu_eval.plot_style import BLUE, GREEN, GREY, ORANGE, Figures, axes

_MARKS = ("o", "s", "^", "D", "v")
_COLOURS = (BLUE, ORANGE, GREEN, GREY, "black")
_KINDS = ("new", "deleted", "moved", "modified")
_STYLES: tuple[tuple[str, Literal["--", "-"]], ...] = (("precision", "--"), ("recall", "-"))
_NEVER = 3e-3  # where a rate of none among those counted is drawn


def law(results: dict[str, Figures]) -> Figure | None:
    """Draw false changes against passes to decide: deletions beside CUSUM, and new signs."""
    figures = results.get("law")
    if figures is None:
        return None
    default, points = figures["default"], figures["points"]
    figure, (deleted, new) = axes(11.0, 5.0, 2)
    own = [p for p in points if (p["trust"], p["forgetting"]) == (default["trust"], default["forgetting"])]
    bounds = {bound["miss_rate"]: bound for bound in figures["bound"]}
    misses = sorted({p["miss_rate"] for p in own if p["side"] == "deleted"})
    for miss, colour, mark in zip(misses, _COLOURS, _MARKS, strict=False):
        curve = [p for p in own if p["side"] == "deleted" and p["miss_rate"] == miss]
        x = [p["passes_to_decision"]["long"]["mean"] for p in curve]
        y = [max(p["false_per_10000"]["long"], _NEVER) for p in curve]
        deleted.plot(x, y, color=colour, marker=mark, label=f"{miss:.0%} misses")
        chosen = [p["enter"] == default["enter"] for p in curve]
        for here, a, b in zip(chosen, x, y, strict=True):
            if here:
                deleted.plot([a], [b], color=colour, marker=mark, markersize=11, markerfacecolor="none")
        deleted.plot(bounds[miss]["passes"], bounds[miss]["false_per_10000"], color=colour, linestyle=":")
    deleted.plot([], [], color="black", linestyle=":", label="CUSUM: the least possible")
    deleted.set_xlabel("mean passes to see a deletion, after a long history")
    deleted.set_ylabel("false deletions per 10,000 passes")
    deleted.set_title("deleted; ringed: the default threshold", fontsize=10)
    counts = sorted({p["contributors"] for p in own if p["side"] == "new"})
    enters = sorted({p["enter"] for p in own if p["side"] == "new"})
    for enter, colour in zip(enters, _COLOURS, strict=False):
        for count, style in zip(counts, ("-", "--", ":"), strict=False):
            curve = [p for p in own if p["side"] == "new" and (p["enter"], p["contributors"]) == (enter, count)]
            x = [100.0 * p["phantom_rate"] for p in curve]
            y = [max(p["false_per_10000"]["fresh"], _NEVER) for p in curve]
            median = curve[0]["passes_to_decision"]["fresh"]["median"] if curve else float("nan")
            label = f"threshold {enter:g}, {count} contributors: {median:g} passes"
            new.plot(x, y, color=colour, linestyle=style, marker="o", label=label)
    new.set_xscale("log")
    phantoms = sorted({100.0 * p["phantom_rate"] for p in own if p["side"] == "new"})
    new.set_xticks(phantoms, [f"{rate:g}" for rate in phantoms])
    new.minorticks_off()
    new.set_xlabel("passes that see a sign where none is, %")
    new.set_ylabel("false new signs per 10,000 passes of a candidate")
    new.set_title("new; with the median of passes that a true one takes", fontsize=10)
    for ax in (deleted, new):
        ax.set_yscale("log")
        ax.axhline(0.1, color="0.6", linewidth=0.8)
        ax.text(
            0.99,
            _NEVER,
            "none counted",
            transform=ax.get_yaxis_transform(),
            va="bottom",
            ha="right",
            fontsize=8,
            color="0.4",
        )
        _legend_below(ax)
    return figure


def _legend_below(ax: Axes, handles: Sequence[Line2D] | None = None) -> None:
    """Put the legend under the axes, where no curve can run into it."""
    options: dict[str, Any] = {} if handles is None else {"handles": handles}
    ax.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False, fontsize=8, handlelength=3.5, **options
    )


def fleet(results: dict[str, Figures]) -> Figure | None:
    """Draw precision and recall of each kind, and the error of new signs, by the size of the fleet."""
    figures = results.get("fleet")
    if figures is None:
        return None
    figure, (right, error) = axes(10.5, 4.9, 2)
    sizes = [int(size) for size in figures["vehicles"]]
    blocks = list(figures["vehicles"].values())
    for kind, colour, mark in zip(_KINDS, _COLOURS, _MARKS, strict=False):
        for name, style in _STYLES:
            y = [None if block[kind][name] is None else 100.0 * block[kind][name] for block in blocks]
            known = [(size, value) for size, value in zip(sizes, y, strict=True) if value is not None]
            right.plot(*zip(*known, strict=True), color=colour, marker=mark, linestyle=style)
    right.set_ylabel("precision and recall, %")
    right.set_ylim(-3.0, 103.0)
    driven = set(sizes)
    for name, label, colour, mark in (
        ("fleet", "each car its own errors", BLUE, "o"),
        ("fleet-common-bias", "and a range bias of 2 % in common", ORANGE, "s"),
    ):
        if name in results:
            cars = results[name]["vehicles"]
            x = [int(size) for size in cars]
            driven.update(x)
            error.plot(
                x, [c["new_position_error_m"]["mean"] for c in cars.values()], color=colour, marker=mark, label=label
            )
            oracle = [c["oracle_position_error_m"] for c in cars.values()]
            error.plot(x, oracle, color=colour, linestyle=":", label="the same with true poses")
    error.set_ylabel("mean error of new signs, m")
    error.set_ylim(bottom=0.0)
    for ax, ticks in ((right, sizes), (error, sorted(driven))):
        ax.set_xscale("log")
        ax.set_xticks(ticks, [str(size) for size in ticks])
        ax.minorticks_off()
        ax.set_xlabel("vehicles that have passed")
    # colour and mark say the kind, the line says which of both figures: six entries instead of eight that look alike
    entries = [
        Line2D([], [], color=colour, marker=mark, linestyle="none", label=kind)
        for kind, colour, mark in zip(_KINDS, _COLOURS, _MARKS, strict=False)
    ]
    entries += [Line2D([], [], color="black", linestyle=style, label=name) for name, style in _STYLES]
    _legend_below(right, entries)
    _legend_below(error)
    return figure
