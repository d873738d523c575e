"""The local east-north frame: an orthographic tangent plane on the WGS84 ellipsoid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_A = 6378137.0  # WGS84 semi-major axis, m
_F = 1.0 / 298.257223563  # WGS84 flattening
_E2 = _F * (2.0 - _F)


def _ecef(lon: Array, lat: Array) -> Array:
    """Return earth-centred coordinates (..., 3) in metres of points on the ellipsoid given in radians."""
    sin_lat, cos_lat = np.sin(lat), np.cos(lat)
    n = _A / np.sqrt(1.0 - _E2 * sin_lat**2)
    return np.stack([n * cos_lat * np.cos(lon), n * cos_lat * np.sin(lon), n * (1.0 - _E2) * sin_lat], axis=-1)


@dataclass(frozen=True)
class LocalFrame:
    """A metric frame, x east and y north, tangent to the ellipsoid at an anchor.

    Distances are short by (d / earth radius)² / 2: below 1 mm per 100 m up to 28 km from the anchor.

    Parameters
    ----------
    lon, lat : the anchor in degrees.
    """

    lon: float
    lat: float
    origin: Array = field(init=False, repr=False, compare=False)  # earth-centred, m
    axes: Array = field(init=False, repr=False, compare=False)  # rows: east, north, up

    def __post_init__(self) -> None:
        lon, lat = np.deg2rad(self.lon), np.deg2rad(self.lat)
        axes = np.array(
            [
                [-np.sin(lon), np.cos(lon), 0.0],
                [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
                [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
            ]
        )
        object.__setattr__(self, "origin", _ecef(np.asarray(lon), np.asarray(lat)))
        object.__setattr__(self, "axes", axes)

    def to_local(self, lon: ArrayLike, lat: ArrayLike) -> Array:
        """Project longitudes and latitudes in degrees, shape (...), to metres east and north, shape (..., 2)."""
        points = _ecef(np.deg2rad(np.asarray(lon, float)), np.deg2rad(np.asarray(lat, float))) - self.origin
        return np.asarray(points @ self.axes[:2].T)

    def to_geographic(self, xy: ArrayLike) -> tuple[Array, Array]:
        """Lift metres east and north, shape (..., 2), to longitude and latitude in degrees, each of shape (...).

        Longitudes are in [-180, 180) and latitudes in [-90, 90], across the antimeridian and over a pole too.
        """
        xy = np.asarray(xy, float)
        if xy.ndim == 1:
            lon, lat = _lift(float(xy[0]), float(xy[1]), self.lat, math)
            lon += self.lon
            lon += 360.0 if lon < -180.0 else 0.0
            return np.asarray(lon - 360.0 if lon >= 180.0 else lon), np.asarray(lat)
        lon, lat = _lift(xy[..., 0], xy[..., 1], self.lat, np)
        lon = lon + self.lon
        lon = np.where(lon < -180.0, lon + 360.0, lon)
        return np.where(lon >= 180.0, lon - 360.0, lon), lat


def _lift(x: Any, y: Any, anchor_lat: float, functions: ModuleType) -> tuple[Any, Any]:
    """Return degrees of longitude from the anchor's meridian, and of latitude.

    Points are lifted to the ellipsoid in closed form: `up` is a root of a quadratic, taken so that no digit is lost.

    Parameters
    ----------
    functions : `math` for one point, for which it is many times faster, or `numpy` for arrays.
    """
    sin, cos = math.sin(math.radians(anchor_lat)), math.cos(math.radians(anchor_lat))
    normal = _A / math.sqrt(1.0 - _E2 * sin**2)
    stretch = 1.0 / (1.0 - _E2)  # of the earth's axis makes the ellipsoid a sphere
    half = normal + (stretch - 1.0) * sin * cos * y
    constant = x * x + (sin**2 + stretch * cos**2) * y * y
    up = -constant / (half + functions.sqrt(half * half - (cos**2 + stretch * sin**2) * constant))
    # in the meridian plane of the anchor: away from the earth's axis, and along it
    away = normal * cos - sin * y + cos * up
    along = normal * sin + stretch * (cos * y + sin * up)
    return functions.degrees(functions.atan2(x, away)), functions.degrees(
        functions.atan2(along, functions.hypot(away, x))
    )


def to_local_each(frames: Sequence[LocalFrame], which: ArrayLike, lon: ArrayLike, lat: ArrayLike) -> Array:
    """Project N places in degrees, each to the frame of its number, to metres east and north, shape (N, 2)."""
    number = np.asarray(which, np.intp)
    origins, axes = np.array([one.origin for one in frames]), np.array([one.axes for one in frames])
    points = _ecef(np.deg2rad(np.asarray(lon, float)), np.deg2rad(np.asarray(lat, float)))
    return np.asarray(np.einsum("nij,nj->ni", axes[number, :2], points - origins[number]))
