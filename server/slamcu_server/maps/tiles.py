"""Web-mercator tiles, and the tile numbers of features: what a MAP_REFERENCE names beside the object id."""

from __future__ import annotations

import math

_ZOOM = 14  # tiles of some 2.4 km at the equator
MAX_LAT = 85.0511  # where the web-mercator square ends


def tile_at(zoom: int, lon: float, lat: float) -> tuple[int, int]:
    """Return x and y of the web-mercator tile that a place (degrees) lies in."""
    size = 1 << zoom
    phi = math.radians(max(-MAX_LAT, min(MAX_LAT, lat)))
    x = math.floor((lon + 180.0) / 360.0 * size)
    y = math.floor((1.0 - math.asinh(math.tan(phi)) / math.pi) / 2.0 * size)
    return max(0, min(x, size - 1)), max(0, min(y, size - 1))


def tile_bounds(zoom: int, x: int, y: int) -> tuple[float, float, float, float]:
    """Return west, south, east and north of a web-mercator tile in degrees."""
    size = 1 << zoom

    def latitude(row: int) -> float:
        return math.degrees(math.atan(math.sinh(math.pi * (1.0 - 2.0 * row / size))))

    return x / size * 360.0 - 180.0, latitude(y + 1), (x + 1) / size * 360.0 - 180.0, latitude(y)


def tile_id(lon: float, lat: float) -> int:
    """Return the number of the web-mercator tile at zoom 14 that a place (degrees) lies in: x * 2^14 + y."""
    x, y = tile_at(_ZOOM, lon, lat)
    return x << _ZOOM | y


def watch_tile_id(lon: float, lat: float) -> int:
    """Return the tile number of a watch feature: negative, because watch features have ids of their own."""
    return -1 - tile_id(lon, lat)
