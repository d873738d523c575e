"""`slamcu-eval plots`: the plots and tables of the documentation, from the JSON that the other commands wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from slamcu_core.errors import FormatError
from slamcu_eval.console import console
from slamcu_eval.plots import draw_all
from slamcu_eval.tables import fill


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("plots")
    def _plots(
        results: Annotated[Path, typer.Option(exists=True, file_okay=False, help="Folder with the JSON results.")],
        out: Annotated[Path, typer.Option(file_okay=False, help="Folder for the plots.")],
        tables: Annotated[
            list[Path] | None,
            typer.Option(exists=True, dir_okay=False, help="Markdown whose marked tables to fill; may be given again."),
        ] = None,
    ) -> None:
        """Draw what is in a folder of results; what has not been measured is left out."""
        figures = read_results(results)
        for name, path in draw_all(figures, out).items():
            console.print(f"{name}: {path}", soft_wrap=True)
        for document in tables or ():
            text = document.read_text(encoding="utf-8")
            document.write_text(fill(text, figures, source=document.name), encoding="utf-8")
            console.print(f"tables: {document}", soft_wrap=True)


def read_results(folder: Path) -> dict[str, Any]:
    """Read every JSON file of a folder, by its name without the ending; raises FormatError for one that is none."""
    results = {}
    for path in sorted(folder.glob("*.json")):
        try:
            results[path.stem] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise FormatError(f"expected JSON: {error}", source=path.name) from error
    return results
