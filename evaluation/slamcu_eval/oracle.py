"""The oracle: how well a sign can be placed from one pass when every pose is known.

It is the yardstick for the filter's new features, and the proof that the simulated sensor is not too good.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Sensor
from slamcu_core.formats.results import ChangeState
from slamcu_core.geometry import wrap_angle
from slamcu_eval.highway import Drive, World

Array = NDArray[np.float64]

_ITERATIONS = 10


def place_by_least_squares(camera: Array, distance: Array, bearing: Array, sensor: Sensor) -> Array:
    """Return the point (2,) that explains N range and bearing measurements from known camera poses (N, 3) best.

    Gauss-Newton from the mean of the single sightings, on residuals weighted by the data sheet's noise. What a vehicle
    has wrong for good is not known to it and not estimated.
    """
    place = single_sightings(camera, distance, bearing).mean(axis=0)
    for _ in range(_ITERATIONS):
        delta = place - camera[:, :2]
        square = (delta**2).sum(axis=1)
        predicted = np.sqrt(square)
        # Of the predicted range: weighing by the measured one would favour what came out short.
        range_std = sensor.range_std_m + sensor.range_std_rel * predicted
        angle = wrap_angle(np.arctan2(delta[:, 1], delta[:, 0]) - camera[:, 2])
        residual = np.concatenate(
            [(distance - predicted) / range_std, wrap_angle(bearing - angle) / sensor.bearing_std_rad]
        )
        jacobian = np.concatenate(
            [
                delta / predicted[:, None] / range_std[:, None],
                np.column_stack([-delta[:, 1], delta[:, 0]]) / square[:, None] / sensor.bearing_std_rad,
            ]
        )
        step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        place = place + step
    return np.asarray(place)


def single_sightings(camera: Array, distance: Array, bearing: Array) -> Array:
    """Return where each of N measurements alone puts its feature, (N, 2)."""
    angle = camera[:, 2] + bearing
    return np.asarray(camera[:, :2] + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def single_sighting_errors(world: World, drive: Drive) -> Array:
    """Return how far (m) each true detection of a drive, taken alone with the true pose, misses its sign."""
    seen = drive.sightings
    real = seen.source >= 0
    places = single_sightings(seen.camera[real], seen.range[real], seen.bearing[real])
    return np.asarray(np.linalg.norm(places - _truth(world, seen.source[real]), axis=1))


def oracle_errors(world: World, drive: Drive, truth: ChangeState | None = ChangeState.NEW) -> dict[int, float]:
    """Return how far (m) least squares with the true poses misses each sign that a drive detected.

    Only signs of one kind, or of every kind if `truth` is None. Keys are indices into `World.signs`.
    """
    places = oracle_places(world, drive, truth)
    return {index: float(np.linalg.norm(xy - _truth(world, np.array([index]))[0])) for index, xy in places.items()}


def oracle_places(world: World, drive: Drive, truth: ChangeState | None = ChangeState.NEW) -> dict[int, Array]:
    """Return where (2,) least squares with the true poses puts each sign that a drive detected, as `oracle_errors`."""
    sensor, seen = drive.header.sensors[0], drive.sightings
    places = {}
    for index in np.unique(seen.source[seen.source >= 0]).tolist():
        if truth is None or world.signs[index].truth is truth:
            rows = seen.source == index
            places[index] = place_by_least_squares(seen.camera[rows], seen.range[rows], seen.bearing[rows], sensor)
    return places


def _truth(world: World, source: NDArray[np.intp]) -> Array:
    return np.array([world.signs[index].place for index in source.tolist()], float).reshape(-1, 2)
