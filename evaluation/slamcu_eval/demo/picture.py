"""From a fleet's result to the picture of its road."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slamcu_eval.demo.drive import FleetResult
from slamcu_eval.highway.world import World
from slamcu_eval.picture import CloseUp, Mark, Outcome, draw_road
from slamcu_eval.score import Place

_CLOSE_UPS = 3


def draw_fleet_result(result: FleetResult, path: Path) -> None:
    """Draw the road with what the cloud says of it, and three new signs from close by."""
    world, said = result.world, result.fused.score
    inside = (world.road.s >= 0.0) & (world.road.s <= world.length_m)
    changes = sum(fact.kind != "normal" for fact in result.facts)
    right = sum(truth == told != "normal" for truth, told in said.said)
    draw_road(
        path,
        road_marks(result),
        title=f"What {len(result.cars)} cars say about {world.length_m / 1e3:g} km of motorway",
        subtitle=(
            f"{right} of {changes} changes found, {len(said.false_new)} invented; "
            f"{said.right} of {len(said.said)} signs told as they are"
        ),
        plan=world.road.xy[inside],
        length_m=world.length_m,
        close_ups=close_ups(result),
    )


def road_marks(result: FleetResult) -> list[Mark]:
    """Return a mark for every true sign and for every claim that is not true."""
    world, said = result.world, result.fused.score
    marks = []
    for fact, (truth, told) in zip(result.facts, said.said, strict=True):
        along, left = _along(world, fact.place)
        if truth == "normal" and told not in {"normal", "unclassified"}:
            marks.append(Mark(along, left, told, Outcome.FALSE))
        else:
            marks.append(Mark(along, left, truth, Outcome.FOUND if truth == told else Outcome.MISSED))
    invented = [_along(world, result.fused.claims[index].place) for index in said.false_new]
    return marks + [Mark(along, left, "new", Outcome.FALSE) for along, left in invented]


def close_ups(result: FleetResult) -> list[CloseUp]:
    """Choose new signs that many cars found, far apart along the road, and put the cars' places around each."""
    seen: dict[int, list[Place]] = {}
    for car in result.cars:
        for match in car.score.matches:
            seen.setdefault(match.fact, []).append(car.claims[match.claim].place)
    found = {match.fact: result.fused.claims[match.claim] for match in result.fused.score.matches}
    chosen: list[CloseUp] = []
    step = result.world.length_m / _CLOSE_UPS
    for part in range(_CLOSE_UPS):
        here = [f for f in found if part * step <= _along(result.world, result.facts[f].place)[0] < (part + 1) * step]
        if not here:
            continue
        index = max(here, key=lambda f: (len(seen.get(f, ())), -f))
        fact, claim = result.facts[index], found[index]
        true = np.array(fact.place)
        kilometre = _along(result.world, fact.place)[0] / 1e3
        fused = np.array(claim.place) - true
        chosen.append(
            CloseUp(
                title=f"{' '.join(filter(None, (fact.sign, fact.value)))}, km {kilometre:.1f}",
                fused=(float(fused[0]), float(fused[1])),
                covariance_m2=claim.covariance or (0.0, 0.0, 0.0),
                singles=np.array(seen.get(index, []), float).reshape(-1, 2) - true,
            )
        )
    return chosen


def _along(world: World, place: Place) -> tuple[float, float]:
    """Return where a place stands along the road, and how far to its left, in metres."""
    road = world.road
    delta = np.array(place) - road.xy
    index = int(np.argmin((delta**2).sum(axis=1)))
    heading = road.heading[index]
    left = float(-np.sin(heading) * delta[index, 0] + np.cos(heading) * delta[index, 1])
    return float(np.clip(road.s[index], 0.0, world.length_m - 1e-6)), left
