"""Angles, the local east-north frame for all metric work, cells of degrees, and 2×2 matrices in closed form."""

from slamcu_core.geometry.angles import compass_to_math, math_to_compass, rotation, wrap_angle, wrap_in_place
from slamcu_core.geometry.cells import Cell, cell_of, cells_within
from slamcu_core.geometry.frame import LocalFrame, to_local_each
from slamcu_core.geometry.symmetric import inverse, mahalanobis_square, times

__all__ = [
    "Cell",
    "LocalFrame",
    "cell_of",
    "cells_within",
    "compass_to_math",
    "inverse",
    "mahalanobis_square",
    "math_to_compass",
    "rotation",
    "times",
    "to_local_each",
    "wrap_angle",
    "wrap_in_place",
]
