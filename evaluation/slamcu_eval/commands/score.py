"""`slamcu-eval score`: a result of a drive or of the cloud against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from slamcu_core.errors import SlamcuError
from slamcu_core.formats.results import ResultFeature, TruthFeature, read_results, read_truth
from slamcu_core.geometry import LocalFrame
from slamcu_eval.console import confusion_table, console, write_json
from slamcu_eval.score import HIGHWAY_RADIUS_M, ROBOT_RADIUS_M, Claim, Fact, figures, score


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("score")
    def _score(
        truth: Annotated[Path, typer.Option(help="Truth file (GeoJSON).")],
        result: Annotated[Path, typer.Option(help="Result of a drive or of the cloud (GeoJSON).")],
        radius_m: Annotated[
            float, typer.Option("--radius", min=0.01, help=f"Metres for a New; {ROBOT_RADIUS_M} for robots.")
        ] = HIGHWAY_RADIUS_M,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    ) -> None:
        """Score a result against the truth: classes, invented features, position errors."""
        with truth.open("rb") as file:
            true = list(read_truth(file, source=str(truth)))
        with result.open("rb") as file:
            said = list(read_results(file, source=str(result)))
        if not true:
            raise SlamcuError(f"{truth}: no features to score against")
        frame = LocalFrame(float(np.mean([f.lon for f in true])), float(np.mean([f.lat for f in true])))
        numbers = figures([score(facts_from(true, frame), claims_from(said, frame), radius_m=radius_m)])
        console.print(confusion_table(numbers["confusion"]))
        console.print(_table(numbers))
        if json_file is not None:
            write_json(json_file, numbers)


def facts_from(features: list[TruthFeature], frame: LocalFrame) -> list[Fact]:
    """Return the facts of a truth file in a metric frame."""
    places = frame.to_local([f.lon for f in features], [f.lat for f in features]).tolist()
    return [
        Fact(f.truth.value, (x, y), f.map_object_id, f.sign, f.value)
        for f, (x, y) in zip(features, places, strict=True)
    ]


def claims_from(features: list[ResultFeature], frame: LocalFrame) -> list[Claim]:
    """Return the claims of a results file in a metric frame."""
    places = frame.to_local([f.lon for f in features], [f.lat for f in features]).tolist()
    return [
        Claim(f.state.value, (x, y), f.covariance_m2, f.map_object_id, f.sign, f.value, f.passes)
        for f, (x, y) in zip(features, places, strict=True)
    ]


def _table(numbers: dict[str, Any]) -> Table:
    table = Table(title="Score")
    table.add_column("figure")
    table.add_column("value", justify="right")
    error = numbers["new_position_error_m"]
    rows = (
        ("features", str(numbers["features"])),
        ("accuracy", f"{numbers['accuracy']:.2%}"),
        ("false new", str(numbers["false_new"])),
        ("never in view", str(numbers["never_in_view"])),
        ("error of new signs, mean", f"{error['mean']:.2f} m"),
        ("  standard deviation", f"{error['std']:.2f} m"),
        ("  median, 95th percentile", f"{error['median']:.2f} m, {error['p95']:.2f} m"),
        ("inside their 95 % ellipse", f"{numbers['ellipse95_coverage']:.1%}"),
    )
    for row in rows:
        table.add_row(*row)
    return table
