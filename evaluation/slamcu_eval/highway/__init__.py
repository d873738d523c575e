"""The paper's motorway, simulated: worlds with out-of-date maps, and fleets that drive along them.

The model with all its numbers stands in `parameters` and in docs/simulator.md.
"""

from __future__ import annotations

from typing import Any

from slamcu_eval.highway.drive import Drive, Reference, Sightings, make_drive
from slamcu_eval.highway.parameters import HighwayParameters
from slamcu_eval.highway.world import World, WorldSign, make_world

__all__ = [
    "Drive",
    "HighwayParameters",
    "Reference",
    "Sightings",
    "World",
    "WorldSign",
    "make_drive",
    "make_world",
    "simulate",
]


def simulate(seed: int, vehicles: int = 1, **changes: Any) -> tuple[World, list[Drive]]:
    """Draw a world and let a fleet drive along it; `changes` name fields of `HighwayParameters`.

    For more drives than memory holds, call `make_world` once and `make_drive` for one vehicle after the other.
    """
    parameters = HighwayParameters().having(**changes)
    world = make_world(seed, parameters.world)
    return world, [make_drive(world, seed, vehicle, parameters) for vehicle in range(vehicles)]
