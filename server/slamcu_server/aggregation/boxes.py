"""Boxes around places: how a set of places probes an index of what is stored."""

from __future__ import annotations

from collections.abc import Iterable

PROBE = "OFFSET 0"
"""Ends a lateral subquery that is to be asked for every box: the planner, whose statistics are always of yesterday,
would rather compare every box with everything there is."""


def degrees(reach_m: float) -> float:
    """Return metres as degrees of latitude, rounded up."""
    return reach_m / 110_500.0


def both_sides(places: Iterable[tuple[int, float, float]]) -> list[tuple[int, float, float]]:
    """Return places and, for those near the antimeridian, the same place counted from its other side."""
    both: list[tuple[int, float, float]] = []
    for map_id, lon, lat in places:
        both.append((map_id, lon, lat))
        if abs(lon) > 179.0:
            both.append((map_id, lon - 360.0 if lon > 0 else lon + 360.0, lat))
    return both


def box(alias: str) -> str:
    """Return the SQL of a box of :reach degrees of latitude around a place; near the poles it is cut off at 89.9°."""
    east = f":reach / greatest(cosd({alias}.lat), 0.0017)"
    return (
        f"ST_MakeEnvelope({alias}.lon - {east}, {alias}.lat - :reach, {alias}.lon + {east}, {alias}.lat + :reach, 4326)"
    )
