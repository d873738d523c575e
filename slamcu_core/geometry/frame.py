"""The local east-north frame: an orthographic tangent plane on the WGS84 ellipsoid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

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


def _metres_per_rad(lat: float) -> tuple[float, float]:
    """Return how many metres a radian of longitude and of latitude (rad) measures."""
    root = math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    return _A / root * math.cos(lat), _A * (1.0 - _E2) / root**3


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
        """Lift metres east and north, shape (..., 2), to longitude and latitude in degrees, each of shape (...)."""
        xy = np.asarray(xy, float)
        if xy.ndim == 1:
            return self._point_to_geographic(float(xy[0]), float(xy[1]))
        # Newton's iteration on (lon, lat) with the local metric at the anchor: error falls by (d / radius) each time.
        lat0 = np.deg2rad(self.lat)
        metres_per_rad_east, metres_per_rad_north = _metres_per_rad(lat0)
        lon = self.lon + np.rad2deg(xy[..., 0] / metres_per_rad_east)
        lat = self.lat + np.rad2deg(xy[..., 1] / metres_per_rad_north)
        for _ in range(6):
            error = xy - self.to_local(lon, lat)
            lon = lon + np.rad2deg(error[..., 0] / metres_per_rad_east)
            lat = lat + np.rad2deg(error[..., 1] / metres_per_rad_north)
        return lon, lat

    def _point_to_geographic(self, x: float, y: float) -> tuple[Array, Array]:
        """Lift one point: the same iteration in plain floats, which for a single point is many times faster."""
        lon0, lat0 = math.radians(self.lon), math.radians(self.lat)
        east, north = _metres_per_rad(lat0)
        sin_lat0, cos_lat0 = math.sin(lat0), math.cos(lat0)
        n0 = _A / math.sqrt(1.0 - _E2 * sin_lat0**2)
        turn, lat = x / east, lat0 + y / north
        for _ in range(8):
            sin_lat, cos_lat = math.sin(lat), math.cos(lat)
            n = _A / math.sqrt(1.0 - _E2 * sin_lat**2)
            radial = n * cos_lat * math.cos(turn) - n0 * cos_lat0
            up = (1.0 - _E2) * (n * sin_lat - n0 * sin_lat0)
            error_x = x - n * cos_lat * math.sin(turn)
            error_y = y - (cos_lat0 * up - sin_lat0 * radial)
            turn, lat = turn + error_x / east, lat + error_y / north
            if abs(error_x) + abs(error_y) < 1e-9:
                break
        return np.asarray(math.degrees(lon0 + turn)), np.asarray(math.degrees(lat))


def to_local_each(frames: Sequence[LocalFrame], which: ArrayLike, lon: ArrayLike, lat: ArrayLike) -> Array:
    """Project N places in degrees, each to the frame of its number, to metres east and north, shape (N, 2)."""
    number = np.asarray(which, np.intp)
    origins, axes = np.array([one.origin for one in frames]), np.array([one.axes for one in frames])
    points = _ecef(np.deg2rad(np.asarray(lon, float)), np.deg2rad(np.asarray(lat, float)))
    return np.asarray(np.einsum("nij,nj->ni", axes[number, :2], points - origins[number]))
