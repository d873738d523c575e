"""The experiment: every attack in random order and with the liars first, and what trust costs honest cars."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import numpy as np

from slamcu_core.hd_map import MapFeature
from slamcu_eval.attack.cars import found, missed, position
from slamcu_eval.attack.judging import Decision, Flip
from slamcu_eval.attack.liars import ATTACKS, LIE
from slamcu_eval.attack.operator import Operator
from slamcu_eval.attack.run import TRUST_EVERY, Driver, Road, make_drivers
from slamcu_eval.attack.world import Truth, make_world
from slamcu_eval.fleet import Cloud

COUNTS = {Truth.UNCHANGED: 30, Truth.DELETED: 6, Truth.NEW: 6, Truth.EMPTY: 8}
ORDERS = ("random", "liars_first")
HEALING = 5
"""Honest passes after which nothing false may stand."""

_LIARS_FIRST_ROUNDS = 2  # drives of each liar before anybody else comes
_FOUND_BEFORE = {"hiding": 2}  # honest drives before the liars who come first: there must be something to hide
_AFTERWARDS = 12  # honest drives after the liars who came first
_FLOOD_PASSES = 1000  # of one message: with their references the most that the server takes
_SETTINGS = {"SLAMCU_PASSES_BURST": "20000"}  # a day's driving at once, so that a flood ends in minutes


@dataclass(frozen=True, slots=True)
class Setting:
    """How many take part."""

    vehicles: int = 60
    colluding: int = 3
    seed: int = 0


def run_attacks(
    names: Iterable[str], orders: Sequence[str], setting: Setting, done: Callable[[dict[str, Any]], None]
) -> dict[str, Any]:
    """Run attacks, each on a server of its own that knows nobody, and return their figures by name and order."""
    figures: dict[str, Any] = {}
    for name in names:
        figures[name] = {}
        for order in orders:
            with Cloud(settings=_SETTINGS) as cloud, Operator(cloud) as operator:
                figures[name][order] = _run(cloud, operator, name, order, setting)
            done(figures)
    return figures


def run_honest(setting: Setting, done: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
    """Let a fleet without liars drive: first nobody has a record, then on another road with what each has earned."""
    rng = np.random.default_rng([setting.seed, 99])
    with Cloud() as cloud, Operator(cloud) as operator:
        drivers = make_drivers(cloud, setting.vehicles, (), rng)
        figures: dict[str, Any] = {}
        for name in ("cold", "established"):
            road = Road(cloud, operator, make_world(name, COUNTS, rng), len(drivers))
            for number in rng.permutation(len(drivers)).tolist():
                road.drive(drivers[number])
            operator.recompute_trust()
            figures[name] = {**_flips(road.feed.flips, road.feed.standing), **_delays(road.feed.decisions)}
            done(figures)
    return figures


def _run(cloud: Cloud, operator: Operator, name: str, order: str, setting: Setting) -> dict[str, Any]:
    rng = np.random.default_rng([setting.seed, *name.encode(), *order.encode()])
    drivers = make_drivers(cloud, setting.vehicles, [ATTACKS[name]] * setting.colluding, rng)
    liars, others = drivers[: setting.colluding], drivers[setting.colluding :]
    if order == "random":
        first = [drivers[number] for number in rng.permutation(len(drivers)).tolist()]
        after = others[:HEALING]
    else:
        before = _FOUND_BEFORE.get(name, 0)
        first = others[:before] + liars * _LIARS_FIRST_ROUNDS
        after = others[before:][:_AFTERWARDS]
    world = make_world(f"{name}-{order}", COUNTS, rng)
    road = Road(cloud, operator, world, len(first) + len(after), trust_every=TRUST_EVERY[order])
    for driver in first:
        road.drive(driver)
        if name == "flooding" and not driver.honest and driver.drives == 1:
            _flood(road, driver)
    standing = road.feed.standing
    for number, driver in enumerate(after, 1):
        road.drive(driver)
        if number == HEALING:
            standing = road.feed.standing
    answers = road.answers
    return {
        **_flips(road.feed.flips, standing),
        **_delays(road.feed.decisions),
        "answers": {
            "accepted": answers.accepted,
            "duplicates": answers.duplicates,
            "refused": answers.refused,
            "throttled": answers.throttled,
            "retry_after_s": answers.retry_after_s,
        },
    }


def _flood(road: Road, driver: Driver) -> None:
    begin = road.now - timedelta(hours=12)
    nowhere = position(np.array([0.0, -500.0]), 0.4)
    road.flood(driver, [found(begin, LIE, nowhere)] * _FLOOD_PASSES, requests=1)  # which no camera can have seen
    target = road.world.of(Truth.UNCHANGED)[0]
    feature = MapFeature(target.object_id or 0, 0.0, 0.0)
    times = [begin + timedelta(seconds=20 * number) for number in range(_FLOOD_PASSES)]
    road.flood(driver, [missed(feature, when, LIE) for when in times])


def _flips(flips: Sequence[Flip], standing: int) -> dict[str, Any]:
    healed = [flip.healed_after - flip.published_after for flip in flips if flip.healed_after is not None]
    kinds = sorted({flip.kind for flip in flips})
    return {
        "flips_published": len(flips),
        "flips_by_kind": {kind: sum(flip.kind == kind for flip in flips) for kind in kinds},
        "flips_standing": standing,
        "passes_to_heal": {
            "median": float(np.median(healed)) if healed else None,
            "max": max(healed) if healed else None,
            "never": len(flips) - len(healed),
        },
    }


def _delays(decisions: Sequence[Decision]) -> dict[str, Any]:
    """Return how many contributors and drives it took to tell the truth, of how many true changes."""
    figures: dict[str, Any] = {}
    for kind, there in (("new", COUNTS[Truth.NEW]), ("deleted", COUNTS[Truth.DELETED])):
        mine = [decision for decision in decisions if decision.kind == kind]
        figures[kind] = {
            "decided": len(mine),
            "of": there,
            "contributors_median": float(np.median([one.contributors for one in mine])) if mine else None,
            "drives_median": float(np.median([one.drives for one in mine])) if mine else None,
        }
    return {"decisions": figures}
