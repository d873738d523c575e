"""The cells that tables of the documentation are made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

Figures = dict[str, Any]


def gap(stage: str) -> str:
    """Return what stands in place of a table that is not measured."""
    return f"*Not measured yet: `scripts/figures {stage}` fills this table.*"


def table_of(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table: text to the left in the first column, numbers to the right in the others."""
    lines = ["| " + " | ".join(head) + " |", "|---" + "|---:" * (len(head) - 1) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def number(value: float | None, digits: int = 2, unit: str = "") -> str:
    """Return a number, or none."""
    return "none" if value is None or not math.isfinite(value) else f"{value:.{digits}f}{unit}"


def share(value: float | None) -> str:
    """Return a share in per cent, or none."""
    return number(None if value is None else 100.0 * value, 1, " %")
