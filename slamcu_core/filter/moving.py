"""What is held in the map's frame, moved rigidly: into another frame, or where the pose turns out to be another."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from slamcu_core.filter.ekf import turned
from slamcu_core.filter.particles import Particles
from slamcu_core.filter.table import FeatureTable

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Move = Callable[[Array], Array]  # of places (..., 2)


def rotation_by(turn: float) -> Array:
    """Return the matrix (2, 2) that turns by `turn` rad."""
    cos, sin = math.cos(turn), math.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])


def move_particles(particles: Particles, slots: Index, to: Move, turn: float) -> None:
    """Move the poses, and the new features in some slots, by a function of places that turns all by `turn` rad."""
    particles.state[:2] = to(particles.state[:2].T).T
    particles.state[2] += turn
    rotation = rotation_by(turn)
    if particles.pending is not None:
        swivel = np.eye(3)
        swivel[:2, :2] = rotation
        particles.pending = np.einsum("ij,jak->iak", swivel, particles.pending)
    particles.means[:, slots] = np.moveaxis(to(np.moveaxis(particles.means[:, slots], 0, -1)), -1, 0)
    cos, sin = rotation[:, 0]
    particles.covariances[:, slots] = turned(cos, -sin, particles.covariances[:, slots])


def move_sightings(table: FeatureTable, rows: Index, to: Move, turn: float) -> None:
    """Move what was noted of the sightings of rows by a function of places that turns all by `turn` rad."""
    rotation = rotation_by(turn)
    information, vector = table.seen_information[rows], table.seen_vector[rows]
    has = np.linalg.det(information) > 1e-12
    sighted = np.zeros_like(vector)
    sighted[has] = to(np.linalg.solve(information[has], vector[has][..., None])[..., 0])
    information = rotation @ information @ rotation.T
    table.seen_information[rows] = information
    table.seen_vector[rows] = (information @ sighted[..., None])[..., 0]
    table.by_scale[rows], table.by_turn[rows] = table.by_scale[rows] @ rotation.T, table.by_turn[rows] @ rotation.T
    looked = rows[table.view_weight[rows] > 0.0]
    weight = table.view_weight[looked, None]
    table.view_from[looked] = to(table.view_from[looked] / weight) * weight
