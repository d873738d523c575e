"""`slamcu-eval law`: false alarms of the evidence law against its delay, and against what no law can beat."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_core.aggregation import Policy
from slamcu_core.errors import SlamcuError
from slamcu_eval.console import console, progress, write_json
from slamcu_eval.law.confirm import confirm
from slamcu_eval.law.curves import FRESH, MISS_RATE, bound_curve, law_curves, settings
from slamcu_eval.law.passes import LONG
from slamcu_eval.machine import machine

_RATES_PER_10000 = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("law")
    def _law(
        *,
        passes: Annotated[
            int, typer.Option(min=1000, help="Passes per setting in which false changes are counted.")
        ] = 1_000_000,
        seed: Annotated[int, typer.Option(min=0, help="Seed of all passes.")] = 0,
        policy_file: Annotated[
            Path | None, typer.Option("--policy", help="Policy to measure (JSON); without it the built-in one.")
        ] = None,
        confirm_with: Annotated[
            int, typer.Option("--confirm", min=0, help="Vehicles that tell a real server; 0: leave that out.")
        ] = 12,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    ) -> None:
        """Count how often the cloud's law is wrong and how many passes it takes to be right.

        No cars drive: streams of passes that saw a sign or missed it go through the server's own fold, millions of
        them, under the default policy and others around it. Signs that stand are missed in 2 to 20 % of passes, each
        pass is another vehicle's. `false` counts changes that begin to stand although nothing changed, per 10,000
        passes: on a fresh map (its first 10 passes) and after a long history (after 40). `delay` is how many passes a
        true change takes; of a deletion after a long history in the worst case, when every pass before saw the sign.

        The last column compares that delay with CUSUM's at the same rate of false alarms: no rule has a lower
        worst-case delay (Lorden 1971, Moustakides 1986), and CUSUM has to be told the rates, which the law is not.
        The goal is at most 1.3 at less than 0.1 false deletions per 10,000 passes and 5 % misses.

        Some of it is then told to a real server by a real client, and compared with the fold.
        """
        policy = _read_policy(policy_file)
        rules = policy.for_class("traffic_sign")
        with progress() as bars:
            bar = bars.add_task("settings", total=len(settings(rules)))
            points = list(law_curves(rules, passes=passes, seed=seed, done=lambda: bars.advance(bar)))
        figures: dict[str, Any] = {
            "default": {name: getattr(rules, name) for name in _NAMED},
            "fresh_passes": FRESH,
            "long_passes": LONG,
            "detection_delay_over_bound": _default(points, rules.enter, MISS_RATE).get("detection_delay_over_bound"),
            "points": points,
            "bound": [
                {
                    "miss_rate": miss,
                    "false_per_10000": list(_RATES_PER_10000),
                    "passes": bound_curve(miss, _RATES_PER_10000),
                }
                for miss in sorted({point["miss_rate"] for point in points})
            ],
            "machine": machine(),
        }
        console.print(_table(points, "deleted"))
        console.print(_table(points, "new"))
        if confirm_with:
            figures["confirmed"] = confirm(policy, vehicles=confirm_with, features=90, seed=seed)
            _print_confirmed(figures["confirmed"])
        if json_file is not None:
            write_json(json_file, figures)


_NAMED = ("trust", "forgetting", "enter", "leave", "contributors_new", "contributors_deleted", "contributor_weight")


def _read_policy(path: Path | None) -> Policy:
    if path is None:
        return Policy()
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise SlamcuError(f"{path}: no JSON: {error}") from error
    return Policy.from_document(document)


def _default(points: list[dict[str, Any]], enter: float, miss_rate: float) -> dict[str, Any]:
    return next(
        point
        for point in points
        if point["side"] == "deleted" and point["enter"] == enter and point["miss_rate"] == miss_rate
    )


def _table(points: list[dict[str, Any]], side: str) -> Table:
    table = Table(title=f"{side}: false changes per 10,000 passes, and passes to decide")
    deleted = side == "deleted"
    for column in ("misses" if deleted else "phantoms", "α", "γ", "enter", "contributors", "false, fresh"):
        table.add_column(column, justify="right")
    for column in ("false, long", "delay, fresh", "delay, long", "mean / bound") if deleted else ("delay",):
        table.add_column(column, justify="right")
    for point in points:
        if point["side"] != side:
            continue
        rate = point["miss_rate"] if deleted else point["phantom_rate"]
        row = [f"{rate:.1%}", f"{point['trust']:g}", f"{point['forgetting']:g}", f"{point['enter']:g}"]
        row += [str(point["contributors"]), f"{point['false_per_10000']['fresh']:.3f}"]
        if deleted:
            row.append(f"{point['false_per_10000']['long']:.3f}")
        row += [f"{one['median']:g} ({one['p95']:g})" for one in point["passes_to_decision"].values()]
        if deleted:
            row.append(f"{point['detection_delay_over_bound']:.2f}")
        table.add_row(*row)
    return table


def _print_confirmed(confirmed: dict[str, Any]) -> None:
    console.print(
        f"through client and server: {confirmed['agree']} of {confirmed['features']} features stand as the fold says, "
        f"{confirmed['passes']} passes of {confirmed['vehicles']} vehicles, masses within "
        f"{confirmed['largest_difference_of_masses']:.0e}"
    )
