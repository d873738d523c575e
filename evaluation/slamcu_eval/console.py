"""Where commands print: results to standard output, progress and errors to standard error."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

console = Console()
error_console = Console(stderr=True)


def progress() -> Progress:
    """Return a progress bar on standard error that shows count, elapsed and remaining time."""
    return Progress(
        TextColumn("[progress.description]{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=error_console,
        transient=True,
    )


def write_json(path: Path, figures: object) -> None:
    """Write figures as JSON; a figure that does not exist (NaN) is written as null."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(_finite(figures), indent=2) + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def share(value: float) -> str:
    """Return a share in percent; none if it is a share of nothing."""
    return f"{value:.1%}" if math.isfinite(value) else "none"


def confusion_table(confusion: dict[str, dict[str, int]]) -> Table:
    """Return a confusion as a table: truth in rows, what was said in columns."""
    table = Table(title="Truth (rows) against what was said (columns)")
    table.add_column("truth")
    columns = list(next(iter(confusion.values()), {}))
    for column in [*columns, "right"]:
        table.add_column(column, justify="right")
    for truth, row in confusion.items():
        total = sum(row.values())
        share = f"{row.get(truth, 0) / total:.1%}" if total else ""
        table.add_row(truth, *(str(row[column]) for column in columns), share)
    return table
