"""The plot of the attacks: what was published that is false, and what of it stood."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from slamcu_eval.plot_style import BLUE, ORANGE, Figures, axes


def attack(results: dict[str, Figures]) -> Figure | None:
    """Draw false changes published, and standing after five honest passes, by attack and order."""
    figures = results.get("attack")
    if figures is None:
        return None
    names = list(figures["attacks"])
    figure, panels = axes(11.0, 3.8, 2)
    for panel, (order, title) in zip(
        panels, (("random", "in random order"), ("liars_first", "the liars first")), strict=True
    ):
        cells = [figures["attacks"][name][order] for name in names]
        x = np.arange(len(names))
        published = panel.bar(x - 0.2, [cell["flips_published"] for cell in cells], 0.4, color=ORANGE)
        standing = panel.bar(x + 0.2, [cell["flips_standing"] for cell in cells], 0.4, color=BLUE)
        published.set_label("published")
        standing.set_label("standing after 5 honest passes")
        for bars in (published, standing):
            panel.bar_label(bars, fontsize=8)
        panel.set_xticks(x, names, rotation=25, ha="right", fontsize=8.5)
        panel.set_ylim(0, max(4, *(1.25 * cell["flips_published"] for cell in cells)))
        panel.set_title(f"{figures['colluding']} liars among {figures['vehicles']} vehicles, {title}", fontsize=10)
        panel.set_ylabel("false changes")
    panels[0].legend(frameon=False, fontsize=9)
    return figure
