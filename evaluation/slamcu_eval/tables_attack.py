"""The tables of the attacks: what was published that is false, and what the guard costs honest cars."""

from __future__ import annotations

from typing import Any

from slamcu_eval.table_cells import Figures, gap, number, table_of

_ORDERS = {"random": "random order", "liars_first": "liars first"}


def attack(results: dict[str, Figures]) -> str:
    """Return what every attack published, in random order and with the liars first."""
    if "attack" not in results:
        return gap("attack")
    rows = [
        (
            f"{name}, {_ORDERS[order]}",
            _published(cell),
            str(cell["flips_standing"]),
            number(cell["passes_to_heal"]["max"], 0),
            *_told(cell),
        )
        for name, orders in results["attack"]["attacks"].items()
        for order, cell in orders.items()
    ]
    head = ("attack", "false published", "standing after 5 honest", "passes to heal, most", "new told", "deleted told")
    return table_of(head, rows)


def attack_cost(results: dict[str, Figures]) -> str:
    """Return how fast a fleet without liars tells the truth, without and with records."""
    if "honest" not in results.get("attack", {}):
        return gap("attack")
    names = {"cold": "nobody has a record", "established": "the same cars on another road"}
    rows = [
        (
            names[name],
            _published(cell),
            *(
                number(cell["decisions"][kind][f"{what}_median"], 1)
                for kind in ("new", "deleted")
                for what in ("contributors", "drives")
            ),
        )
        for name, cell in results["attack"]["honest"].items()
    ]
    head = ("fleet without liars", "false published", "new: contributors", "drives", "deleted: contributors", "drives")
    return table_of(head, rows)


def _published(cell: dict[str, Any]) -> str:
    kinds = ", ".join(f"{count} {kind}" for kind, count in cell["flips_by_kind"].items())
    return f"{cell['flips_published']} ({kinds})" if kinds else str(cell["flips_published"])


def _told(cell: dict[str, Any]) -> list[str]:
    return [f"{cell['decisions'][kind]['decided']} of {cell['decisions'][kind]['of']}" for kind in ("new", "deleted")]
