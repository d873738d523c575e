"""A picture of a road with its changes: what is true, what the cloud made of it, and how well it places new signs.

Twenty kilometres do not fit on a page, so the road is cut into rows of equal length and straightened: signs stand on
stems beside it, at their place along it and on their side. A plan shows its true shape, close-ups the positions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Rectangle
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Okabe and Ito's colours, told apart by people with any kind of colour vision; shapes say the same once more.
_COLOURS = {"normal": "#8c8c8c", "new": "#0072b2", "deleted": "#d55e00", "moved": "#cc79a7", "modified": "#b88a00"}
_MARKERS = {"normal": "o", "new": "^", "deleted": "X", "moved": "D", "modified": "s"}
_SIZES = {"normal": 4.4, "new": 8.0, "deleted": 8.5, "moved": 7.0, "modified": 7.0}
_ROAD = 1.0  # half width of the road as drawn; heights count from it
_STEM = 1.5  # height of the first sign above the middle of the road, and of each one stacked on it
_NEAR_M = 75.0  # m along the road; closer marks on one side are stacked
_CHI2_95 = 5.991  # of two degrees of freedom


class Outcome(StrEnum):
    """What the cloud made of a feature."""

    FOUND = "found"  # said what is true
    MISSED = "missed"  # did not
    FALSE = "false"  # said something of a place where nothing is


@dataclass(frozen=True, slots=True)
class Mark:
    """One feature of the picture."""

    along: float  # m along the road
    left: float  # m to the left of its middle
    kind: str  # normal, new, deleted, moved or modified: what is true; of a false one what was said
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class CloseUp:
    """A new sign from above, in metres east and north of where it truly stands."""

    title: str
    fused: tuple[float, float]
    covariance_m2: tuple[float, float, float]  # xx, xy, yy
    singles: Array = field(default_factory=lambda: np.empty((0, 2)))  # (K, 2) where single vehicles put it


def draw_road(
    path: Path,
    marks: Sequence[Mark],
    *,
    title: str,
    subtitle: str,
    plan: Array,
    length_m: float,
    close_ups: Sequence[CloseUp] = (),
    rows: int = 5,
) -> None:
    """Write a picture of a road and its changes to a file; its suffix says the format (png, svg, pdf).

    Parameters
    ----------
    plan : (K, 2) points of the road's middle in metres east and north, from its start.
    length_m : of the road, cut into `rows` rows.
    close_ups : of new signs; the first three are shown.
    """
    figure = Figure(figsize=(16.0, 9.6), dpi=110)
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        rows, 2, width_ratios=(4.4, 1.0), left=0.02, right=0.985, top=0.885, bottom=0.085, wspace=0.05, hspace=0.12
    )
    figure.text(0.02, 0.955, title, fontsize=17, fontweight="bold")
    figure.text(0.02, 0.922, subtitle, fontsize=11.5, color="#444444")
    heights = stack(marks, length_m / rows)
    for row in range(rows):
        _draw_row(figure.add_subplot(grid[row, 0]), row, length_m / rows, marks, heights)
    right = grid[:, 1].subgridspec(1 + min(len(close_ups), 3), 1, hspace=0.32)
    _draw_plan(figure.add_subplot(right[0]), plan, length_m, marks)
    for index, close_up in enumerate(close_ups[:3]):
        _draw_close_up(figure.add_subplot(right[1 + index]), close_up, legend=index == 0)
    figure.legend(
        handles=_legend(marks), loc="lower left", bbox_to_anchor=(0.015, 0.005), ncols=9, frameon=False, fontsize=11
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def stack(marks: Sequence[Mark], row_m: float) -> list[float]:
    """Return a height per mark, signed by side, so that marks close to each other do not cover each other."""
    heights = [0.0] * len(marks)
    last: dict[tuple[int, bool], list[tuple[float, int]]] = {}
    for index in sorted(range(len(marks)), key=lambda i: marks[i].along):
        mark = marks[index]
        side = mark.left > 0
        neighbours = last.setdefault((int(mark.along // row_m), side), [])
        taken = {level for along, level in neighbours if mark.along - along < _NEAR_M}
        level = next(level for level in range(len(marks) + 1) if level not in taken)
        neighbours.append((mark.along, level))
        height = _ROAD + _STEM * (level + 0.7)
        heights[index] = height if side else -height
    return heights


def _draw_row(axes: Axes, row: int, row_m: float, marks: Sequence[Mark], heights: Sequence[float]) -> None:
    start = row * row_m
    axes.set_xlim(start - 0.012 * row_m, start + 1.012 * row_m)
    axes.set_ylim(-5.6, 5.6)
    axes.set_axis_off()
    axes.add_patch(Rectangle((start, -_ROAD), row_m, 2 * _ROAD, facecolor="#d9dadd", edgecolor="none", zorder=0))
    axes.plot([start, start + row_m], [0.0, 0.0], color="white", lw=1.6, dashes=(9, 7), zorder=1)
    for kilometre in np.arange(np.ceil(start / 1000.0), (start + row_m) / 1000.0 + 1e-9):
        axes.text(1000.0 * kilometre, 0.0, f"{kilometre:g} km", ha="center", va="center", fontsize=8.5, color="#666666",
                  bbox={"facecolor": "#d9dadd", "edgecolor": "none", "pad": 1.5}, zorder=2)  # fmt: skip
    for mark, height in zip(marks, heights, strict=True):
        if start <= mark.along < start + row_m:
            edge = np.sign(height) * _ROAD
            axes.plot([mark.along, mark.along], [edge, height], color="#b5b5b5", lw=0.8, zorder=1)
            _draw_mark(axes, mark, mark.along, height)


def _draw_mark(axes: Axes, mark: Mark, x: float, y: float) -> None:
    colour, size = _COLOURS[mark.kind], _SIZES[mark.kind]
    missed = mark.outcome is Outcome.MISSED
    axes.plot(x, y, _MARKERS[mark.kind], ms=size, mfc="white" if missed else colour, mec=colour, mew=1.4, zorder=4)
    if mark.outcome is Outcome.FALSE:
        axes.plot(x, y, "s", ms=size + 7, mfc="none", mec="black", mew=1.3, zorder=5)
    elif missed:
        axes.plot(x, y, "o", ms=size + 7, mfc="none", mec=colour, mew=1.0, zorder=5)


def _draw_plan(axes: Axes, plan: Array, length_m: float, marks: Iterable[Mark]) -> None:
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(plan, axis=0).T))])
    along *= length_m / along[-1]
    axes.plot(*plan.T, color="#c4c6ca", lw=4.0, solid_capstyle="round", zorder=1)
    axes.plot(*plan[0], "o", ms=5, color="#444444", zorder=2)
    axes.annotate("start", plan[0], xytext=(6, -10), textcoords="offset points", fontsize=8.5, color="#444444")
    for mark in sorted(marks, key=lambda m: m.kind != "normal"):
        if mark.kind != "normal":
            x, y = (float(np.interp(mark.along, along, plan[:, axis])) for axis in (0, 1))
            axes.plot(x, y, _MARKERS[mark.kind], ms=3.5, color=_COLOURS[mark.kind], zorder=3)
    axes.margins(0.12)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("the road from above, north up", fontsize=10)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color("#cccccc")


def _draw_close_up(axes: Axes, close_up: CloseUp, *, legend: bool) -> None:
    axes.plot(*close_up.singles.T, ".", ms=7, color="#999999", label="one car", zorder=2)
    axes.plot(0.0, 0.0, "+", ms=13, mew=2.0, color="black", label="truth", zorder=3)
    axes.plot(*close_up.fused, "^", ms=8, color=_COLOURS["new"], label="fleet", zorder=4)
    xx, xy, yy = close_up.covariance_m2
    values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    width, height = 2.0 * np.sqrt(_CHI2_95 * np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    axes.add_patch(
        Ellipse(close_up.fused, width, height, angle=angle, facecolor="#0072b222", edgecolor=_COLOURS["new"], lw=1.4)
    )
    reach = max(1.0, 1.15 * float(np.abs(close_up.singles).max(initial=0.0)), max(np.abs(close_up.fused)) + width)
    reach = min(reach, 4.0)
    axes.set_xlim(-1.6 * reach, 1.6 * reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal", adjustable="box")
    axes.grid(color="#eeeeee")
    axes.tick_params(labelsize=8, length=2)
    axes.set_title(close_up.title, fontsize=10)
    axes.set_ylabel("m", fontsize=8, labelpad=0)
    if legend:
        axes.legend(fontsize=8.5, loc="lower right", handletextpad=0.2, borderpad=0.3, ncols=1)


def _legend(marks: Iterable[Mark]) -> list[Line2D]:
    marks = list(marks)
    kinds = [kind for kind in _COLOURS if any(mark.kind == kind for mark in marks)]
    names = {"normal": "unchanged", "moved": "moved", "modified": "other sign"}
    handles = [
        Line2D(
            [], [], ls="", marker=_MARKERS[kind], ms=_SIZES[kind] + 1, color=_COLOURS[kind], label=names.get(kind, kind)
        )
        for kind in kinds
    ]
    for marker, colour, label in (("o", "#555555", "hollow, ringed: missed"), ("s", "black", "boxed: false")):
        handles.append(Line2D([], [], ls="", marker=marker, mfc="none", mec=colour, ms=13, label=label))
    return handles
