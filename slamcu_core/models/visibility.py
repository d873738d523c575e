"""Field of view and occlusion: how likely a sensor could have seen a feature (errata to eq. 2)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slamcu_core.drive import Occluder, Sensor
from slamcu_core.geometry import wrap_in_place

Array = NDArray[np.float64]

_OCCLUDER_RANGE_STD = 1.0  # m; a feature closer than this behind an object's near face may stand before it
_OCCLUDER_MARGIN_M = 0.3  # m added to each side: reported widths cut mirrors and loads


def visibility_probability(sensor: Sensor, distance: Array, bearing: Array, weights: Array) -> Array:
    """Return for F features the probability, over M particles, of standing in the field of view, shape (F,).

    Parameters
    ----------
    distance, bearing : true range (m) and bearing (rad, within ±2π) of each feature from each particle, (F, M).
    weights : normalised weights of the particles, (M,).
    """
    half = math.radians(sensor.fov_deg) / 2.0
    aside = np.abs(bearing)
    inside = aside <= half
    if half > 0.5 * math.pi:
        inside |= aside >= 2.0 * math.pi - half
    inside &= distance >= sensor.min_range_m
    inside &= distance <= sensor.max_range_m
    return np.asarray(inside @ weights)


def shadow_angle(occluder: Occluder) -> float:
    """Return half the angle (rad) that an object hides."""
    return math.atan2(occluder.width / 2.0 + _OCCLUDER_MARGIN_M, max(occluder.range, 0.1))


def occlusion_probability(occluders: Sequence[Occluder], distance: Array, bearing: Array, bearing_std: Array) -> Array:
    """Return for F features the probability of standing behind an object, shape (F,).

    Parameters
    ----------
    distance, bearing : mean range (m) and bearing (rad) of the features, (F,).
    bearing_std : uncertainty of those bearings (rad), (F,).
    """
    visible = np.ones_like(distance)
    for occluder in occluders:
        half = shadow_angle(occluder)
        offset = bearing - occluder.bearing
        wrap_in_place(offset)
        behind = _logistic((distance - occluder.range) / (0.5 * _OCCLUDER_RANGE_STD))
        inside = _logistic((half - np.abs(offset)) / np.maximum(0.6 * bearing_std, 1e-4))
        visible *= 1.0 - behind * inside
    return 1.0 - visible


def _logistic(x: Array) -> Array:
    """Return 1 / (1 + exp(-x)) without overflow."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(x, -500.0, 500.0))))
