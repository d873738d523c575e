"""`slamcu-eval attack`: liars, lost cars and floods against the real server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slamcu_core.errors import SlamcuError
from slamcu_eval.attack.experiment import ORDERS, Setting, run_attacks, run_honest
from slamcu_eval.attack.liars import ATTACKS
from slamcu_eval.console import console, progress, write_json
from slamcu_eval.machine import machine


def register(app: typer.Typer) -> None:
    """Add the command to the application."""

    @app.command("attack")
    def _attack(
        *,
        vehicles: Annotated[int, typer.Option(min=10, help="Vehicles, liars included.")] = 60,
        colluding: Annotated[int, typer.Option(min=1, help="Liars, who agree on what they say.")] = 3,
        only: Annotated[
            list[str] | None, typer.Option(help=f"Only this attack ({', '.join(ATTACKS)}); may be given again.")
        ] = None,
        order: Annotated[
            list[str] | None, typer.Option(help=f"Only this order ({', '.join(ORDERS)}); may be given again.")
        ] = None,
        honest: Annotated[bool, typer.Option("--honest/--no-honest", help="Also a fleet without liars.")] = True,
        seed: Annotated[int, typer.Option(min=0, help="Seed of the world, the cars and their order.")] = 0,
        json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    ) -> None:
        """Let liars report among honest cars, and count what the service publishes that is false."""
        unknown = sorted(set(only or ()) - ATTACKS.keys())
        if unknown:
            raise SlamcuError(f"there is no attack {unknown[0]!r}; there are {', '.join(ATTACKS)}")
        if not set(order or ()) <= set(ORDERS):
            raise SlamcuError(f"an order is one of {', '.join(ORDERS)}")
        if colluding > vehicles // 2:
            raise SlamcuError(f"{colluding} liars among {vehicles} vehicles: at most half may lie")
        names, orders, setting = list(only or ATTACKS), list(order or ORDERS), Setting(vehicles, colluding, seed)
        with progress() as bars:
            bar = bars.add_task(f"{len(names)} attacks", total=len(names) * len(orders) + 2 * honest)
            figures: dict[str, Any] = {
                "vehicles": vehicles,
                "colluding": colluding,
                "seed": seed,
                "machine": machine(),
                "attacks": {},
            }

            def done(part: str, measured: dict[str, Any]) -> None:
                bars.advance(bar)
                figures[part] = measured
                if json_file is not None:
                    write_json(json_file, figures)  # what has been measured is not lost if the rest fails

            run_attacks(names, orders, setting, lambda measured: done("attacks", measured))
            if honest:
                run_honest(setting, lambda measured: done("honest", measured))
        console.print(attack_table(figures))


def attack_table(figures: dict[str, Any]) -> Table:
    """Return the figures as a table."""
    table = Table(title=f"{figures['colluding']} liars among {figures['vehicles']} vehicles")
    table.add_column("attack")
    table.add_column("order")
    for column in ("false published", "standing after 5 honest", "passes to heal (most)", "truth told"):
        table.add_column(column, justify="right")
    rows = [(name, order, cell) for name, orders in figures["attacks"].items() for order, cell in orders.items()]
    rows += [("none", name, cell) for name, cell in figures.get("honest", {}).items()]
    for name, order, cell in rows:
        told = [cell["decisions"][kind] for kind in ("new", "deleted")]
        most = cell["passes_to_heal"]["max"]
        table.add_row(
            name,
            order,
            str(cell["flips_published"]),
            str(cell["flips_standing"]),
            "" if most is None else str(most),
            f"{sum(one['decided'] for one in told)} of {sum(one['of'] for one in told)}",
        )
    return table
