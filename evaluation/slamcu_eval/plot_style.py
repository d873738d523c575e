"""What all plots share: colours that colour-blind readers can tell apart, and plain axes."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette; markers differ as well
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"

Figures = dict[str, Any]


def axes(width: float, height: float, columns: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure of a size in inches with axes side by side."""
    figure, panels = plt.subplots(1, columns, figsize=(width, height), squeeze=False, layout="constrained", **options)
    for ax in panels[0]:
        ax.grid(visible=True, axis="y", color="0.88", linewidth=0.8)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, list(panels[0])
