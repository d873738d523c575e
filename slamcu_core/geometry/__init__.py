"""Angles, and the local east-north frame in which all metric work happens."""

from slamcu_core.geometry.angles import compass_to_math, math_to_compass, rotation, wrap_angle, wrap_in_place
from slamcu_core.geometry.frame import LocalFrame, to_local_each

__all__ = [
    "LocalFrame",
    "compass_to_math",
    "math_to_compass",
    "rotation",
    "to_local_each",
    "wrap_angle",
    "wrap_in_place",
]
