"""What the demonstration prints and writes down: the cloud against the truth, and one car against the fleet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.table import Table

from slamcu_eval.demo.drive import FleetResult
from slamcu_eval.demo.review import Acceptance
from slamcu_eval.score import Score, figures

_NAMES = {"normal": "unchanged", "deleted": "deleted", "new": "new"}


def demo_figures(result: FleetResult) -> dict[str, Any]:
    """Return the figures of the cloud, and those of the cars each by itself."""
    cars = figures([car.score for car in result.cars])
    steps = np.concatenate([outcome.step_ms for outcome in result.outcomes])
    return {
        "vehicles": len(result.cars),
        "passes": result.passes,
        "messages": result.messages,
        "fleet": figures([result.fused.score]),
        "one_car": {**cars, "false_new_per_car": cars["false_new"] / len(result.cars)},
        "step_ms": {"mean": float(steps.mean()), "p99": float(np.percentile(steps, 99))},
    }


def comparison_table(result: FleetResult) -> Table:
    """Return the table of truth against cloud, per kind of change, with what one car says beside it."""
    numbers = demo_figures(result)
    fleet, car = numbers["fleet"], numbers["one_car"]
    table = Table(title="Truth against cloud, and one car against the fleet")
    table.add_column("")
    for column in ("true", "the fleet says so", "one car says so (mean)"):
        table.add_column(column, justify="right")
    singles = [one.score for one in result.cars]
    for kind, name in _NAMES.items():
        true, right = _right([result.fused.score], kind)
        _, alone = _right(singles, kind)
        table.add_row(f"{name} signs", str(true), f"{right}  ({_share(right, true)})", _mean(alone, true, len(singles)))
    table.add_section()
    table.add_row("invented new signs", "0", str(fleet["false_new"]), f"{car['false_new_per_car']:.1f}")
    table.add_row("right in all", str(fleet["features"]), f"{fleet['accuracy']:.1%}", f"{car['accuracy']:.1%}")
    table.add_section()
    for label, name in (("error of new signs, mean", "mean"), ("  95th percentile", "p95")):
        table.add_row(label, "", *(f"{one['new_position_error_m'][name]:.2f} m" for one in (fleet, car)))
    table.add_row("inside their 95 % ellipse", "", *(f"{one['ellipse95_coverage']:.0%}" for one in (fleet, car)))
    return table


def acceptance_table(acceptance: Acceptance, map_name: str) -> Table:
    """Return what the review did to the map."""
    change, feature = acceptance.change, acceptance.feature
    what = " ".join(filter(None, (change["sign"], change["value"]))) or change["class"]
    table = Table(title=f"Change {change['id']} accepted through the API: a new {what}")
    for column in ("", "before", "after"):
        table.add_column(column)
    table.add_row("version of " + map_name, acceptance.version_before, acceptance.version_after)
    table.add_row("features in it", str(acceptance.features_before), str(acceptance.features_after))
    lon, lat = change["geometry"]["coordinates"][:2]
    place = f"{lat:.6f}, {lon:.6f}"
    seen = f"change {change['id']}, seen by {change['contributors_for']} cars"
    table.add_row("the sign", f"{seen}, at {place}", f"feature {feature['id']}" if feature else "not in the list")
    return table


def _right(scores: Sequence[Score], kind: str) -> tuple[int, int]:
    """Return how often a kind is true, and how often it was told so."""
    pairs = [pair for one in scores for pair in one.said if pair[0] == kind]
    return len(pairs), sum(truth == said for truth, said in pairs)


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.0%}" if whole else "-"


def _mean(right: int, true: int, cars: int) -> str:
    return f"{right / cars:.1f}  ({_share(right, true * cars)})"
