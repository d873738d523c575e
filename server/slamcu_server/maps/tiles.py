"""Tile numbers of features: what a MAP_REFERENCE names beside the object id."""

from __future__ import annotations

import math

_ZOOM = 14  # tiles of some 2.4 km at the equator
_MAX_LAT = 85.0511  # where the web-mercator square ends


def tile_id(lon: float, lat: float) -> int:
    """Return the number of the web-mercator tile at zoom 14 that a place (degrees) lies in: x * 2^14 + y."""
    size = 1 << _ZOOM
    phi = math.radians(max(-_MAX_LAT, min(_MAX_LAT, lat)))
    x = int((lon + 180.0) / 360.0 * size)
    y = int((1.0 - math.asinh(math.tan(phi)) / math.pi) / 2.0 * size)
    return min(x, size - 1) << _ZOOM | max(0, min(y, size - 1))


def watch_tile_id(lon: float, lat: float) -> int:
    """Return the tile number of a watch feature: negative, because watch features have ids of their own."""
    return -1 - tile_id(lon, lat)
